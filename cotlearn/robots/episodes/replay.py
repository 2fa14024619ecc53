"""Diffusion Policy's replay buffers: a zarr group with data/ and meta/episode_ends."""

import zipfile
from collections.abc import Sequence
from json import JSONDecodeError
from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.robots.episodes.checked import need


def read_buffer(path: str | Path, states: Sequence[str] = ("data/state",)) -> tuple[Any, ...]:
    """Reads states, actions and ends of a replay buffer (2303.04137).

    Files like `pusht_cchi_v7_replay.zarr` hold data/state (N, 5) with agent x and y, block x, y and
    angle, data/action (N, 2), and meta/episode_ends (E,). Images and key points are not read.

    Args:
        path: the folder, or a zip file of it.
        states: candidate names of the states; the first existing one is read.

    Returns:
        The arrays of states, actions and episode ends.

    Raises:
        ModuleNotFoundError: zarr is not installed.
        ValueError: the file is damaged, or something is missing.
    """
    path, zarr = Path(path), need("zarr")
    if path.is_file() and not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is damaged: it is neither a folder nor a whole zip file")
    storage = zarr.storage.LocalStore if path.is_dir() else zarr.storage.ZipStore
    try:
        with storage(path, read_only=True) as store:
            group = zarr.open_group(store, mode="r")
            state = next((name for name in states if name in group), states[0])
            names = (state, "data/action", "meta/episode_ends")
            if missing := [name for name in names if name not in group]:
                raise ValueError(f"{path} has no {', no '.join(missing)}: it is no replay buffer")
            return tuple(np.asarray(group[name][:]) for name in names)
    except (OSError, MemoryError, RuntimeError, zipfile.BadZipFile, JSONDecodeError) as error:
        raise ValueError(f"{path} is damaged or not a zarr group: {error}") from error
