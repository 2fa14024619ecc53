"""The planned demonstrator of Push-T."""

from cotlearn.robots.experts.push_t.expert import Episode, Options, PushTExpert

__all__ = ["Episode", "Options", "PushTExpert"]
