"""Reads demonstrations of every known layout; writes them as images."""

from pathlib import Path

import numpy as np
import torch

from cotlearn.files import atomic_path
from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.episodes.lerobot import read_lerobot
from cotlearn.robots.episodes.npz import read_npz
from cotlearn.robots.episodes.replay import read_buffer
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.push_t.rasteriser import rasterise


def read(path: str | Path) -> Episodes:
    """Reads demonstrations; the layout is recognised from the path.

    Args:
        path: this course's `.npz`; Diffusion Policy's `.zarr` folder or `.zarr.zip`; or the
            folder of a LeRobot data set (with `meta/info.json` or `data/*.parquet`).

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or its layout is unknown.
    """
    path = Path(path)
    if not (path.is_file() or path.is_dir()):  # a pipe would be read without end
        raise FileNotFoundError(f"no such file: {path}")
    if path.suffix == ".npz":
        return read_npz(path)
    if ".zarr" in path.suffixes or (path / ".zgroup").is_file() or (path / "zarr.json").is_file():
        state, action, ends = read_buffer(path)
        return Episodes(state, action, ends, name=path.name)
    if (path / "meta" / "info.json").is_file() or any(path.glob("data/**/*.parquet")):
        return read_lerobot(path)
    known = "an .npz of this course, a .zarr of Diffusion Policy, a LeRobot folder"
    raise ValueError(f"the layout of {path} is unknown: expected {known}")


def write_pictures(path: str | Path, episodes: Episodes, *, size: int = 96) -> None:
    """Writes images, agent positions and actions as a compressed `.npz`, atomically.

    This exports data for other programs; the course itself renders images when it needs them. The
    arrays are "pixels" (rows, size, size, 3) uint8, "agent_pos" (rows, 2) float32, "action"
    (rows, 2) float32, and "episode_ends" (episodes,), exclusive.

    Args:
        path: the file.
        episodes: episodes of Push-T; all images are held in memory, 28 kB for each of 96 x 96.
        size: width and height of an image in pixels.

    Raises:
        ValueError: the episodes are of another task.
    """
    if episodes.task is not PUSH_T:
        raise ValueError(f"episodes must be of push-t, got {episodes.task.name}")
    pictures = rasterise(torch.from_numpy(episodes.state), size=size)
    with atomic_path(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            pixels=pictures.contiguous().numpy(),
            agent_pos=episodes.state[:, :2].astype(np.float32),
            action=episodes.action.astype(np.float32),
            episode_ends=episodes.ends,
        )
