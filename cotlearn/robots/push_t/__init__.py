"""Push-T: push a T-shaped block onto its outline with a round finger.

The task is that of Implicit Behavioral Cloning and Diffusion Policy, as defined by gym-pusht 0.1.8.
It is implemented anew on pymunk 7, which is imported when the first simulation is created.
"""

from cotlearn.robots.push_t.constants import GOAL
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.push_t.expert import PushTExpert
from cotlearn.robots.push_t.geometry import corners, coverage
from cotlearn.robots.push_t.simulation import PushTVectorSim, Simulation, random_state

__all__ = [
    "GOAL",
    "PUSH_T",
    "PushTExpert",
    "PushTVectorSim",
    "Simulation",
    "corners",
    "coverage",
    "random_state",
]
