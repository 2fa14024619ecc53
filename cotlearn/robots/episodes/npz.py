"""This course's format of demonstrations: an `.npz` without pickles, with these arrays.

- state, int16 (N, columns): states before each control step, rounded to the units of the task;
- action, int16 (N, columns): executed actions in units of the task, exact;
- intention, int16 (N, columns): the expert's actions before noise in units of the task, exact;
- episode_ends, int64 (E,): exclusive end of each episode, as in Diffusion Policy's files;
- seed, uint32 (E,): seeds of the exact starts, as in `env.reset(seed=...)`;
- mode, int8 (E,): the mode that the expert chose, if it chooses one in advance;
- about: JSON text on how the file was made, with the SHA-256 of the arrays.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.files import atomic_path, reading
from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.registry import TASKS

Arrays = dict[str, NDArray[Any]]
WANTED = {"state", "action", "intention", "episode_ends", "seed"}


def read_npz(path: str | Path) -> Episodes:
    """Reads demonstrations that `cotlearn.robots.episodes.record.record` wrote.

    Raises:
        ValueError: the file is missing or damaged, or has another format or an unknown task.
    """
    arrays, about = read_arrays(path)
    task = TASKS.get(str(about.get("task")).lower())
    if task is None:
        raise ValueError(f"{path} holds demonstrations of an unknown task, {about.get('task')!r}")
    if not arrays.keys() >= WANTED:
        raise ValueError(_no_recording(path, arrays))
    return Episodes(
        state=arrays["state"] * np.array(task.state_units),
        action=arrays["action"] * np.array(task.action_units),
        ends=arrays["episode_ends"],
        task=task,
        name=Path(path).name,
        intention=arrays["intention"] * np.array(task.action_units),
        seed=arrays["seed"],
        mode=arrays.get("mode"),
    )


def write_arrays(path: str | Path, arrays: Arrays, about: dict[str, Any]) -> None:
    """Writes the arrays of a recording atomically; the same arrays give the same bytes."""
    text = json.dumps({"about": about, "sha256": _digest(arrays)}, sort_keys=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, about=np.array(text), **arrays)


def read_arrays(path: str | Path) -> tuple[Arrays, dict[str, Any]]:
    """Reads and checks the arrays and the metadata that `write_arrays` wrote."""
    with reading(path, "no file of demonstrations"):
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            held = file.files
            arrays = {name: file[name] for name in held if name != "about"}
            record = json.loads(str(file["about"])) if "about" in held else None
        about, digest = (dict(record["about"]), record["sha256"]) if record else ({}, "")
    if record is None:
        raise ValueError(_no_recording(path, held))
    if digest != _digest(arrays):
        raise ValueError(f"{path} is damaged: its arrays do not match their SHA-256")
    return arrays, about


def _no_recording(path: str | Path, held: Iterable[str]) -> str:
    """Says what a file holds, and which files are wanted."""
    return (
        f"{path} is no recording: it holds {', '.join(sorted(held)) or 'nothing'}. Wanted is an "
        ".npz that `cotlearn demos` wrote, or Push-T as a .zarr or a LeRobot folder; of an .npz "
        "with x1 and c, `cotlearn report` makes a page"
    )


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
