"""A seven-joint arm that reaches around pillars, on MuJoCo.

MuJoCo itself is imported when the first world is made.
"""

from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.kinematics import Solution, forward, skeleton, solve
from cotlearn.robots.arm.simulation import ArmWorlds, random_start
from cotlearn.robots.arm.task import KINDS, MAX_STEPS, SUCCESS, WAYS, columns, pillars
from cotlearn.robots.arm.ways import way_round

__all__ = [
    "KINDS",
    "MAX_STEPS",
    "SUCCESS",
    "WAYS",
    "ArmWorlds",
    "GoalFrame",
    "Solution",
    "columns",
    "forward",
    "pillars",
    "random_start",
    "skeleton",
    "solve",
    "way_round",
]
