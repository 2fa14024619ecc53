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
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.files import atomic_path
from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.registry import TASKS

Arrays = dict[str, NDArray[Any]]
_NO_ZIP = (OSError, MemoryError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error)


def read_npz(path: str | Path) -> Episodes:
    """Reads demonstrations that `cotlearn.robots.experts.record` wrote.

    Raises:
        ValueError: the file is missing or damaged, or has another format or an unknown task.
    """
    arrays, about = read_arrays(path)
    task = TASKS.get(str(about.get("task")).lower())
    if task is None:
        raise ValueError(f"{path} holds demonstrations of an unknown task, {about.get('task')!r}")
    return Episodes(
        state=arrays["state"] * np.array(task.state_units),
        action=arrays["action"] * np.array(task.action_units),
        ends=arrays["episode_ends"],
        name=Path(path).name,
        intention=arrays["intention"] * np.array(task.action_units),
        seed=arrays["seed"],
        mode=arrays.get("mode"),
        task=task,
    )


def write_arrays(path: str | Path, arrays: Arrays, about: dict[str, Any]) -> None:
    """Writes the arrays of a recording atomically; the same arrays give the same bytes."""
    text = json.dumps({"about": about, "sha256": _digest(arrays)}, sort_keys=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, about=np.array(text), **arrays)


def read_arrays(path: str | Path) -> tuple[Arrays, dict[str, Any]]:
    """Reads and checks the arrays and the metadata that `write_arrays` wrote."""
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files if name != "about"}
            record = json.loads(str(file["about"]))
        about, digest = dict(record["about"]), record["sha256"]
    except (ValueError, TypeError, KeyError, *_NO_ZIP) as error:
        why = str(error).partition(" If you trust")[0]  # NumPy's advice to load it unsafely
        raise ValueError(f"{path} is damaged or no file of demonstrations: {why}") from error
    if digest != _digest(arrays):
        raise ValueError(f"{path} is damaged: its arrays do not match their SHA-256")
    return arrays, about


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
