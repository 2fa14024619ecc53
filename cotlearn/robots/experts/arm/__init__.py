"""The demonstrator of the arm: choose a mode, and follow a smooth path of it."""

from cotlearn.robots.experts.arm.expert import ArmExpert

__all__ = ["ArmExpert"]
