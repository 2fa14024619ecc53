"""A seven-joint arm that reaches around pillars, on MuJoCo.

MuJoCo itself is imported when the first simulation is made.
"""

from cotlearn.renamed import renamed
from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.kinematics import Solution, forward, skeleton, solve
from cotlearn.robots.arm.modes import homotopy_class
from cotlearn.robots.arm.simulation import ArmVectorSim, random_start
from cotlearn.robots.arm.task import KINDS, MAX_STEPS, MODES, SUCCESS, columns, pillars

__all__ = [
    "KINDS",
    "MAX_STEPS",
    "MODES",
    "SUCCESS",
    "ArmVectorSim",
    "GoalFrame",
    "Solution",
    "columns",
    "forward",
    "homotopy_class",
    "pillars",
    "random_start",
    "skeleton",
    "solve",
]

__getattr__ = renamed(__name__, {"WAYS": "MODES", "way_round": "homotopy_class"})
