"""LeRobot's layout: parquet tables with one row per frame, and JSON metadata."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.files import atomic_path, reading, write_text
from cotlearn.robots.episodes.checked import Episodes, need
from cotlearn.robots.layout import (
    ACTION,
    ENVIRONMENT_STATE,
    EPISODE,
    FRAME,
    STATE,
    Columns,
    LeRobotLayout,
)
from cotlearn.robots.registry import TASKS
from cotlearn.robots.task import Task

OBSERVATIONS = (STATE, ENVIRONMENT_STATE)
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
_FIRST = "chunk-000/file-000.parquet"


def read_lerobot(path: str | Path) -> Episodes:
    """Reads a LeRobot data set of a task that has a layout, such as lerobot/pusht_keypoints.

    The pose of Push-T's T is computed from its key points, so image-only data sets cannot be read.

    Args:
        path: the folder that holds data/ and meta/.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: a file is damaged, or a column is missing or does not fit.
    """
    path = Path(path)
    columns, ends = read_frames(path)
    task, layout = _task_of(path, columns)
    try:
        state = layout.states(columns)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    return Episodes(state, columns[ACTION], ends, task, name=path.name)


def _task_of(path: Path, columns: Columns) -> tuple[Task, LeRobotLayout]:
    """The task whose layout has these columns."""
    widths = {name: columns[name].shape[1] for name in OBSERVATIONS if name in columns}
    wanted = []
    for task in TASKS.values():
        layout = task.lerobot
        if layout is None:
            continue
        if layout.widths == widths:
            return task, layout
        wanted.append(f"{task.name} needs {layout.content} in {dict(layout.widths)}")
    raise ValueError(f"{path} has observations of the widths {widths}; {'; '.join(wanted)}")


def tables(path: Path) -> list[str]:
    """The parquet files of a data set, but for hidden ones, such as macOS's `._file.parquet`."""
    found = sorted(path.glob("data/**/*.parquet"))
    return [str(file) for file in found if not file.name.startswith(".")]


def read_frames(path: str | Path) -> tuple[dict[str, NDArray[Any]], NDArray[np.int64]]:
    """Reads states and actions of any LeRobot data set.

    All parquet tables under data/ are concatenated, so every layout can be read: one file for all
    episodes, for each episode or for several.

    Returns:
        Columns, sorted by episode and frame: action and the existing columns of
        `OBSERVATIONS` (N, width), and the episode and frame indices (N,). Then the exclusive ends
        (E,) of the episodes.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: a file is damaged, or a column is missing or does not fit.
    """
    files = tables(Path(path))
    if not files:
        raise ValueError(f"{path} holds no data/**/*.parquet: it is no LeRobot data set")
    parquet = need("pyarrow.parquet")
    with reading(path, "holds a file that is not a parquet file"):
        frames = parquet.ParquetDataset(files, page_checksum_verification=True)
        names = frames.schema.names
    lists = [*([name for name in OBSERVATIONS if name in names] or [STATE]), ACTION]
    if missing := [name for name in (*lists, EPISODE, FRAME) if name not in names]:
        raise ValueError(f"{path} has no column {', '.join(missing)}; it has {names}")
    with reading(path, "holds a file that is not a parquet file"):
        table = frames.read(columns=[*lists, EPISODE, FRAME])
    if not len(table):
        raise ValueError(f"{path} has no frames: its tables have no rows")
    columns = {name: table[name].to_numpy() for name in (EPISODE, FRAME)}
    for name, values in columns.items():
        if values.dtype.kind not in "iu":  # with gaps, numbers become floating point
            raise ValueError(f"{path}: {name} must hold an integer in each frame")
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


def write_lerobot(path: str | Path, episodes: Episodes) -> Path:
    """Writes episodes in LeRobot's layout (version 3.0) with the columns of the task's layout.

    Args:
        path: a folder that does not exist or is empty.
        episodes: episodes of a task that has a layout, as Push-T.

    Returns:
        The folder.

    Raises:
        ModuleNotFoundError: pyarrow is not installed.
        ValueError: the folder is not empty, or the task has no layout.
    """
    path = Path(path)
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise ValueError(f"path must be an empty folder, but {path} holds something")
    layout = episodes.task.lerobot
    if layout is None:
        raise ValueError(f"episodes of {episodes.task.name} have no layout of LeRobot")
    columns = _columns(episodes, layout)
    _write_table(path / "data" / _FIRST, columns)
    metadata: dict[str, Any] = {
        "episode_index": np.arange(len(episodes)),
        "tasks": [[layout.instruction]] * len(episodes),
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
    _write_table(
        path / "meta" / "tasks.parquet",
        {"task_index": [0], "task": [layout.instruction]},
        index="task",
    )
    stats = {name: _statistics(values) for name, values in columns.items()}
    for file, value in (("stats.json", stats), ("info.json", _info(episodes, columns, layout))):
        write_text(path / "meta" / file, json.dumps(value, indent=1) + "\n")
    return path


def _columns(episodes: Episodes, layout: LeRobotLayout) -> dict[str, NDArray[Any]]:
    """The table of the frames."""
    frame = np.arange(len(episodes.state)) - np.repeat(episodes.starts, episodes.lengths)
    seen = layout.observations(episodes.state)
    reward = layout.rewards(episodes.state)
    last = np.isin(np.arange(len(frame)), episodes.ends - 1)
    after = np.where(last, reward, np.roll(reward, -1))  # of the state that follows, if any
    return {
        **{name: values.astype(np.float32) for name, values in seen.items()},
        ACTION: episodes.action.astype(np.float32),
        "next.reward": after.astype(np.float32),
        "next.done": last,
        EPISODE: np.repeat(np.arange(len(episodes)), episodes.lengths),
        FRAME: frame,
        "timestamp": (frame * layout.control_seconds).astype(np.float32),
        "index": np.arange(len(frame)),
        "task_index": np.zeros(len(frame), dtype=np.int64),
    }


def _info(
    episodes: Episodes, columns: dict[str, NDArray[Any]], layout: LeRobotLayout
) -> dict[str, Any]:
    return {
        "codebase_version": "v3.0",
        "robot_type": layout.robot,
        "total_episodes": len(episodes),
        "total_frames": len(episodes.state),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 500,
        "fps": round(1 / layout.control_seconds),
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
    if index is not None:
        table = table.replace_schema_metadata({"pandas": _for_pandas(table.schema, index)})
    with atomic_path(file) as temporary:
        parquet.write_table(table, temporary)


def _for_pandas(schema: Any, index: str) -> str:
    """What pandas must know of each column to make one of them its index, as JSON.

    LeRobot finds a task by this index. The keys are those of pandas' developer guide, "Storing
    pandas DataFrame objects in Apache Parquet format".
    """
    columns = [
        {
            "name": field.name,
            "field_name": field.name,
            "pandas_type": "int64" if field.type == "int64" else "unicode",
            "numpy_type": "int64" if field.type == "int64" else "object",
            "metadata": None,
        }
        for field in schema
    ]
    return json.dumps({"index_columns": [index], "column_indexes": [], "columns": columns})
