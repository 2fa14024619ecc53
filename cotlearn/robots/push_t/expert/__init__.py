"""The planned demonstrator of Push-T."""

from cotlearn.robots.push_t.expert.expert import PushTExpert

__all__ = ["PushTExpert"]
