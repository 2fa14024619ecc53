"""The demonstrator of the arm: it chooses a mode and follows a smooth path of this mode."""

from cotlearn.robots.arm.expert.expert import ArmExpert

__all__ = ["ArmExpert"]
