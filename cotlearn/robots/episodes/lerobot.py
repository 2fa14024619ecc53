"""LeRobot's layout of Push-T: parquet tables with one row per frame, and JSON metadata."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.files import atomic_path, write_text
from cotlearn.robots.episodes.checked import Episodes, need
from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.geometry import corners, coverage
from cotlearn.robots.push_t.task import CONTROL_SECONDS, KEYPOINTS, SUCCESS
from cotlearn.robots.task import Array

AGENT, BLOCK, ACTION = "observation.state", "observation.environment_state", "action"
STATES = (AGENT, BLOCK)
EPISODE, FRAME = "episode_index", "frame_index"
TASK = "Push the T-shaped block onto the T-shaped target."
RIGID = 2.0  #: largest distance of key points from a rigid T, pixels
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = "chunk-000/file-000.parquet"


def read_lerobot(path: str | Path) -> Episodes:
    """Reads a LeRobot data set of Push-T with key points, such as lerobot/pusht_keypoints.

    The pose of the T is computed from its key points, so image-only data sets cannot be read.

    Args:
        path: the folder that holds data/ and meta/.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: a file is damaged, or a column is missing or does not fit.
    """
    path = Path(path)
    columns, ends = read_frames(path)
    for name, width in ((AGENT, 2), (BLOCK, 2 * len(KEYPOINTS))):
        if name not in columns or columns[name].shape[1] != width:
            needed = f"agent and pose of the T are needed, here {width} numbers a frame"
            raise ValueError(f"{path} has no column {name}; {needed}")
    pose, miss = pose_of(columns[BLOCK].reshape(-1, len(KEYPOINTS), 2))
    if not (miss <= RIGID).all():
        row = int(np.flatnonzero(~(miss <= RIGID))[0])
        raise ValueError(
            f"{path}: the key points of frame {columns[FRAME][row]} of episode "
            f"{columns[EPISODE][row]} are no T of this size: they miss it by {miss[row]:.3g} pixels"
        )
    return Episodes(np.hstack([columns[AGENT], pose]), columns[ACTION], ends, name=path.name)


def read_frames(path: str | Path) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Reads states and actions of any LeRobot data set.

    All parquet tables under data/ are concatenated, so every layout can be read: one file for all
    episodes, for each episode or for several.

    Returns:
        Columns, sorted by episode and frame: action and the existing columns of `STATES`
        (N, width), and the episode and frame indices (N,). Then the exclusive ends (E,) of the
        episodes.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: a file is damaged, or a column is missing or does not fit.
    """
    files = [str(file) for file in sorted(Path(path).glob("data/**/*.parquet"))]
    if not files:
        raise ValueError(f"{path} holds no data/**/*.parquet: it is no LeRobot data set")
    pyarrow, parquet = need("pyarrow"), need("pyarrow.parquet")
    try:
        frames = parquet.ParquetDataset(files)
        names = frames.schema.names
        lists = [*([name for name in STATES if name in names] or [AGENT]), ACTION]
        if missing := [name for name in (*lists, EPISODE, FRAME) if name not in names]:
            raise ValueError(f"{path} has no column {', '.join(missing)}; it has {names}")
        table = frames.read(columns=[*lists, EPISODE, FRAME])
    except (pyarrow.ArrowException, OSError) as error:
        raise ValueError(f"{path}: a file is damaged or not a parquet file: {error}") from error
    columns = {name: table[name].to_numpy() for name in (EPISODE, FRAME)}
    for name in lists:
        try:
            values = np.array(table[name].to_pylist(), dtype=np.float64)
        except (TypeError, ValueError):
            raise ValueError(f"{path}: {name} must hold as many numbers in each frame") from None
        columns[name] = values.reshape(len(values), -1)
    order = np.lexsort((columns[FRAME], columns[EPISODE]))
    columns = {name: values[order] for name, values in columns.items()}
    episode = columns[EPISODE]
    ends = np.append(np.flatnonzero(np.diff(episode)) + 1, len(episode))
    lengths = np.diff(ends, prepend=0)
    expected = np.arange(len(episode)) - np.repeat(ends - lengths, lengths)
    if (wrong := columns[FRAME] != expected).any():
        row = int(np.flatnonzero(wrong)[0])
        raise ValueError(
            f"{path}: frames of episode {episode[row]} are missing or double: frame "
            f"{columns[FRAME][row]} follows where {expected[row]} should"
        )
    return columns, ends


def pose_of(points: Array) -> tuple[Array, Array]:
    """Fit poses (n, 3) of the T to key points (n, 8, 2); also return the largest misses (n,).

    This is least squares over rotations and translations (Kabsch in the plane).
    """
    own = np.array(KEYPOINTS)
    middle, own_middle = points.mean(axis=1), own.mean(axis=0)
    there, here = points - middle[:, None], own - own_middle
    along = (there * here).sum(axis=(1, 2))
    across = (here[:, 0] * there[..., 1] - here[:, 1] * there[..., 0]).sum(axis=1)
    angle = np.arctan2(across, along)
    pose = np.column_stack([middle - rotate(own_middle, np.cos(angle), np.sin(angle)), angle])
    miss = np.linalg.norm(corners(pose, points=KEYPOINTS) - points, axis=2).max(axis=1)
    return pose, miss


def write_lerobot(path: str | Path, episodes: Episodes) -> Path:
    """Writes episodes in LeRobot's layout (version 3.0) with key points as observations.

    Args:
        path: a folder that does not exist or is empty.
        episodes: episodes of Push-T.

    Returns:
        The folder.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: the folder is not empty.
    """
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"path must be an empty folder, but {path} holds something")
    columns = _columns(episodes)
    _write_table(path / "data" / _FIRST, columns)
    metadata: dict[str, Any] = {
        "episode_index": np.arange(len(episodes)),
        "tasks": [[TASK]] * len(episodes),
        "length": episodes.lengths,
        "dataset_from_index": episodes.starts,
        "dataset_to_index": episodes.ends,
    }
    for place in ("data", "meta/episodes"):  # all is in the first file of the first chunk
        for number in ("chunk_index", "file_index"):
            metadata[f"{place}/{number}"] = np.zeros(len(episodes), dtype=np.int64)
    bounds = list(zip(episodes.starts, episodes.ends, strict=True))
    for name, values in columns.items():
        each = [_statistics(values[first:last]) for first, last in bounds]
        metadata |= {f"stats/{name}/{key}": [stats[key] for stats in each] for key in each[0]}
    _write_table(path / "meta" / "episodes" / _FIRST, metadata)
    _write_table(path / "meta" / "tasks.parquet", {"task_index": [0], "task": [TASK]}, index="task")
    stats = {name: _statistics(values) for name, values in columns.items()}
    for file, value in (("stats.json", stats), ("info.json", _info(episodes, columns))):
        write_text(path / "meta" / file, json.dumps(value, indent=1) + "\n")
    return path


def _columns(episodes: Episodes) -> dict[str, NDArray[Any]]:
    """The table of the frames."""
    frame = np.arange(len(episodes.state)) - np.repeat(episodes.starts, episodes.lengths)
    points = corners(episodes.state[:, 2:], points=KEYPOINTS).reshape(len(frame), -1)
    covered = coverage(episodes.state[:, 2:])
    last = np.isin(np.arange(len(frame)), episodes.ends - 1)
    after = np.where(last, covered, np.roll(covered, -1))  # of the state that follows, if any
    return {
        AGENT: episodes.state[:, :2].astype(np.float32),
        BLOCK: points.astype(np.float32),
        ACTION: episodes.action.astype(np.float32),
        "next.reward": np.clip(after / SUCCESS, 0, 1).astype(np.float32),
        "next.done": last,
        EPISODE: np.repeat(np.arange(len(episodes)), episodes.lengths),
        FRAME: frame,
        "timestamp": (frame * CONTROL_SECONDS).astype(np.float32),
        "index": np.arange(len(frame)),
        "task_index": np.zeros(len(frame), dtype=np.int64),
    }


def _info(episodes: Episodes, columns: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "robot_type": "2d pointer",
        "total_episodes": len(episodes),
        "total_frames": len(episodes.state),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 500,
        "fps": round(1 / CONTROL_SECONDS),
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": f"data/{_PATH}",
        "video_path": None,
        "features": {
            name: {"dtype": str(v.dtype), "shape": list(v.shape[1:]) or [1], "names": None}
            for name, v in columns.items()
        },
    }


def _statistics(values: NDArray[Any]) -> dict[str, Any]:
    numbers = values.reshape(len(values), -1).astype(np.float64)
    each = {name: getattr(numbers, name)(axis=0).tolist() for name in ("min", "max", "mean", "std")}
    return {**each, "count": [len(numbers)]}


def _write_table(file: Path, columns: dict[str, Any], index: str | None = None) -> None:
    pyarrow, parquet = need("pyarrow"), need("pyarrow.parquet")
    stored = dict(columns)
    for name, values in columns.items():
        if isinstance(values, np.ndarray) and values.ndim == 2:  # lists, in the type of the matrix
            flat = pyarrow.array(values.reshape(-1))
            stored[name] = pyarrow.FixedSizeListArray.from_arrays(flat, values.shape[1])
    table = pyarrow.table(stored)
    if index is not None:  # what pandas needs to know to make that column its index
        pandas = {"index_columns": [index], "column_indexes": [], "columns": []}
        table = table.replace_schema_metadata({"pandas": json.dumps(pandas)})
    with atomic_path(file) as temporary:
        parquet.write_table(table, temporary)
