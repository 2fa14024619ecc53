"""The demonstrator of the arm: choose a way round the pillars, and follow it smoothly."""

from cotlearn.robots.experts.arm.expert import ArmExpert, Episode
from cotlearn.robots.experts.arm.path import minimum_jerk, via_points

__all__ = ["ArmExpert", "Episode", "minimum_jerk", "via_points"]
