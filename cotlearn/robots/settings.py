"""What the course trains and compares, by name: a task's demonstrations and options."""

from __future__ import annotations

from dataclasses import dataclass

from cotlearn.robots.training import Options


@dataclass(frozen=True)
class Setting:
    """A task as it stands in the course.

    Attributes:
        demonstrations: the file in `data/`.
        options: of every training.
    """

    demonstrations: str
    options: Options


SETTINGS = {"push-t": Setting("push_t_demos.npz", Options(frame="body"))}
