"""The planned demonstrator of Push-T."""

from cotlearn.robots.experts.push_t.expert import PushTExpert

__all__ = ["PushTExpert"]
