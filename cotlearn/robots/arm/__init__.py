"""A seven-joint arm that reaches around pillars, on MuJoCo.

MuJoCo is imported when the first simulation is created.
"""

from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.kinematics import forward, skeleton, solve
from cotlearn.robots.arm.simulation import ArmVectorSim, random_start
from cotlearn.robots.arm.task import MODES

__all__ = ["MODES", "ArmVectorSim", "GoalFrame", "forward", "random_start", "skeleton", "solve"]
