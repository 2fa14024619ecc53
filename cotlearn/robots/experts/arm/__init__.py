"""The demonstrator of the arm: choose a mode, and follow a smooth path of it."""

from cotlearn.robots.experts.arm.expert import ArmExpert
from cotlearn.robots.experts.arm.path import minimum_jerk, via_points

__all__ = ["ArmExpert", "minimum_jerk", "via_points"]
