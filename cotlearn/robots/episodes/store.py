"""Reads demonstrations of every known layout."""

from pathlib import Path
from typing import Any

from cotlearn.files import check_input
from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.episodes.lerobot import read_lerobot, tables
from cotlearn.robots.episodes.npz import read_npz
from cotlearn.robots.episodes.replay import is_buffer, read_buffer
from cotlearn.robots.registry import TASKS
from cotlearn.robots.task import Task


def read(path: str | Path) -> Episodes:
    """Reads demonstrations; the layout is recognised from the path.

    Args:
        path: this course's `.npz`; Diffusion Policy's `.zarr` folder or a zip file of it; or the
            folder of a LeRobot data set (with `meta/info.json` or `data/*.parquet`).

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or its layout is unknown, or its name is not UTF-8.
    """
    path = check_input(path)
    if path.suffix == ".npz":
        return read_npz(path)
    if is_buffer(path):
        state, action, ends = read_buffer(path)
        return Episodes(state, action, ends, _task_of(path, state, action), name=path.name)
    if (path / "meta" / "info.json").is_file() or tables(path):
        return read_lerobot(path)
    known = "an .npz of this course, a .zarr of Diffusion Policy, a LeRobot folder"
    raise ValueError(f"the layout of {path} is unknown: expected {known}")


def _task_of(path: Path, state: Any, action: Any) -> Task:
    """The task whose states and actions have as many columns as these; a buffer names none."""
    got = state.shape[1:], action.shape[1:]
    for task in TASKS.values():
        if got == ((len(task.state),), (len(task.action),)):
            return task
    sizes = [f"{task.name} {len(task.state)} and {len(task.action)}" for task in TASKS.values()]
    raise ValueError(
        f"{path} has states and actions of the shapes {state.shape} and {action.shape}, "
        f"which is no task's; numbers of columns are: {', '.join(sizes)}"
    )
