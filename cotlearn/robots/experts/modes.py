"""The modes that the demonstrator takes from the same starts."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cotlearn.progress import progress_bar
from cotlearn.robots.task import Task

_CHOICES = 3_000_000_000  #: first seed of the expert's choices


def demonstrated_modes(task: Task, seeds: Sequence[int], *, draws: int) -> NDArray[np.int64]:
    """The mode of each of `draws` demonstrations from each start, (starts, draws).

    Args:
        task: the task to demonstrate.
        seeds: seeds of the starts.
        draws: demonstrations from each start.
    """
    expert, sim = task.expert(), task.vector_sim(np.repeat(np.asarray(seeds), draws).tolist())
    starts = sim.states
    actions = np.zeros((task.mode_steps, len(starts), len(task.action)))
    lengths = np.zeros(len(starts), dtype=np.int64)
    with progress_bar(total=len(starts), what="demonstrations") as bar:
        for row, start in enumerate(starts):
            done = expert.episode(_CHOICES + row, state=start).action[: task.mode_steps]
            actions[: len(done), row], lengths[row] = done, len(done)
            bar.update()
    for now in range(task.mode_steps):
        sim.step(actions[now], active=(now < lengths) & ~sim.finished)
    return sim.outcomes()["mode"].astype(np.int64).reshape(-1, draws)
