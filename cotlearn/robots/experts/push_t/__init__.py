"""The planned demonstrator of Push-T."""

from cotlearn.robots.experts.push_t.expert import Options, PushTExpert

__all__ = ["Options", "PushTExpert"]
