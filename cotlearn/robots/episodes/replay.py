"""Diffusion Policy's replay buffer of Push-T: a zarr group with data/ and meta/episode_ends."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.robots.episodes.checked import Episodes, need


def read_replay_buffer(path: str | Path) -> Episodes:
    """Reads `pusht_cchi_v7_replay.zarr` and files like it (2303.04137).

    They hold data/state (N, 5) with agent x and y, block x, y and angle, data/action (N, 2), and
    meta/episode_ends (E,); images and key points are left alone.

    Args:
        path: the folder, or a zip of it.

    Raises:
        ModuleNotFoundError: zarr is not installed.
        ValueError: the file is damaged, or something is missing.
    """
    path = Path(path)
    zarr = need("zarr")
    if path.is_file() and not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is damaged: it is neither a folder nor a whole zip file")
    try:
        if path.is_file():
            with zarr.storage.ZipStore(path, mode="r") as store:
                arrays = _arrays(zarr.open_group(store, mode="r"), path)
        else:
            arrays = _arrays(zarr.open_group(path, mode="r"), path)
    except FileNotFoundError as error:
        raise ValueError(f"{path} is not a zarr group: {error}") from error
    except (OSError, RuntimeError, NotImplementedError) as error:  # zip, blosc
        raise ValueError(f"{path} is damaged: {type(error).__name__}: {error}") from error
    return Episodes(
        arrays["data/state"], arrays["data/action"], arrays["meta/episode_ends"], name=path.name
    )


def _arrays(group: Any, path: Path) -> dict[str, Any]:
    names = ("data/state", "data/action", "meta/episode_ends")
    for name in names:
        if name not in group:
            raise ValueError(f"{path} has no {name}: it is no replay buffer of Push-T with states")
    return {name: np.asarray(group[name][:]) for name in names}
