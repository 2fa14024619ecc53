"""Read demonstrations from wherever they are."""

from __future__ import annotations

from pathlib import Path

from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.episodes.lerobot import read_lerobot
from cotlearn.robots.episodes.replay import read_replay_buffer
from cotlearn.robots.registry import find_task


def read(path: str | Path) -> Episodes:
    """Reads demonstrations, in the layout that the path suggests.

    Args:
        path: this course's `.npz`; Diffusion Policy's `.zarr` folder or `.zarr.zip`; or the
            folder of a LeRobot data set (with `meta/info.json` or `data/*.parquet`).

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or of no layout that is known.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    if path.suffix == ".npz":
        return _read_own(path)
    if ".zarr" in path.suffixes or (path / ".zgroup").is_file() or (path / "zarr.json").is_file():
        return read_replay_buffer(path)
    if (path / "meta" / "info.json").is_file() or any(path.glob("data/**/*.parquet")):
        return read_lerobot(path)
    raise ValueError(
        f"{path} is of no known layout: expected an .npz of this course, a .zarr of Diffusion "
        "Policy, or the folder of a LeRobot data set"
    )


def _read_own(path: Path) -> Episodes:
    from cotlearn.robots.experts.record import load

    stored = load(path)
    return Episodes(
        state=stored.state,
        action=stored.action,
        ends=stored.episode_ends,
        name=path.name,
        intention=stored.intention,
        seed=stored.seed.astype("int64"),
        mode=None if stored.mode is None else stored.mode.astype("int64"),
        task=find_task(stored.about["task"].lower()),
    )
