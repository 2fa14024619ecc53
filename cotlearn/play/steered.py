"""Demonstrations of Push-T that a script steers, for where nobody can push."""

from __future__ import annotations

from pathlib import Path

from cotlearn.play.recorder import Recorder
from cotlearn.robots.push_t import PushTExpert
from cotlearn.validation import check_count

AT_ONCE = 24  #: steps that the script takes before it looks again


def steer(path: str | Path, *, episodes: int, seed: int = 0) -> Path:
    """Record episodes as a hand would, each in less than a second.

    The script sees what a hand sees, the rounded state, and moves the pointer where the planner of
    the course would, which plans again every 2.4 s.

    Args:
        path: the `.npz` file to write; an existing recording of the script is completed.
        episodes: how many the file should have.
        seed: of the first start.

    Returns:
        The path.

    Raises:
        ValueError: the file is damaged, holds another recording, or cannot be written.
    """
    check_count(episodes, "episodes")
    recorder = Recorder(path, seed=seed, demonstrator="by a script")
    expert, looks = PushTExpert(), 0
    while (done := len(recorder)) < episodes:
        looks += 1
        for target in expert.episode(looks, state=recorder.view["state"]).intention[:AT_ONCE]:
            recorder.step(*target.tolist())
            if len(recorder) > done:
                break
    return recorder.path
