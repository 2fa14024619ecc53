"""Read demonstrations from wherever they are."""

from __future__ import annotations

from pathlib import Path

from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.episodes.lerobot import read_lerobot
from cotlearn.robots.episodes.npz import read_npz
from cotlearn.robots.episodes.replay import read_replay_buffer


def read(path: str | Path) -> Episodes:
    """Reads demonstrations, in the layout that the path suggests.

    Args:
        path: this course's `.npz`; Diffusion Policy's `.zarr` folder or `.zarr.zip`; or the
            folder of a LeRobot data set (with `meta/info.json` or `data/*.parquet`).

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or its layout is unknown.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.suffix == ".npz":
        return read_npz(path)
    if ".zarr" in path.suffixes or (path / ".zgroup").is_file() or (path / "zarr.json").is_file():
        return read_replay_buffer(path)
    if (path / "meta" / "info.json").is_file() or any(path.glob("data/**/*.parquet")):
        return read_lerobot(path)
    raise ValueError(
        f"the layout of {path} is unknown: expected an .npz of this course, a .zarr of Diffusion "
        "Policy, or the folder of a LeRobot data set"
    )
