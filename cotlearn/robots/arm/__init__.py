"""A seven-joint arm that reaches around pillars, on MuJoCo.

MuJoCo is imported when the first simulation is created.
"""

from cotlearn.robots.arm.constants import MODES
from cotlearn.robots.arm.definition import ARM_AVOID, ARM_RING
from cotlearn.robots.arm.expert import ArmExpert
from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.kinematics import forward, skeleton, solve
from cotlearn.robots.arm.simulation import ArmVectorSim, random_start

__all__ = [
    "ARM_AVOID",
    "ARM_RING",
    "MODES",
    "ArmExpert",
    "ArmVectorSim",
    "GoalFrame",
    "forward",
    "random_start",
    "skeleton",
    "solve",
]
