"""Reads your own data: arrays, an .npz, a LeRobot folder, a Diffusion Policy zarr."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.files import check_input, reading
from cotlearn.robots.episodes.checked import window_rows
from cotlearn.robots.episodes.lerobot import OBSERVATIONS, read_frames, tables
from cotlearn.robots.episodes.replay import is_buffer, read_buffer
from cotlearn.robots.layout import ACTION
from cotlearn.validation import (
    check_count,
    check_matrix,
    check_real,
    check_same_rows,
    check_single,
)

MOST_LABELS = 64  #: distinct values of a vector of labels
FEW = 20  #: distinct whole values of a column that may be labels
EXPECTED = "an .npz with x1 and c, a LeRobot folder, or a Diffusion Policy .zarr"


@dataclass(frozen=True)
class Rows:
    """A data set and its groups of rows that belong together.

    Attributes:
        data: x1 (n, d) and c (n, k), float32.
        group: (n,), rows with the same number are never split between training and test.
        about: where it comes from, a few words.
        code: Python that reads it again from its file; empty if it came as arrays.
    """

    data: Dataset
    group: NDArray[np.int64]
    about: str
    code: str = ""


def read_data(path: str | Path, *, observe: int = 2, predict: int = 16) -> Rows:
    """Reads data of any layout that is known.

    An .npz holds `x1` and `c` as for `from_arrays`, and `group` if rows belong together. Recorded
    episodes (LeRobot: observation.state, action, episode_index; zarr: data/state or data/obs,
    data/action, meta/episode_ends) become windows as by `from_episodes`.

    Args:
        path: the file or folder.
        observe: steps of a recording that the condition holds.
        predict: actions of a recording that x1 holds.

    Raises:
        FileNotFoundError: there is no such file.
        ModuleNotFoundError: pyarrow or zarr is needed and not installed.
        ValueError: the file is damaged, of no known layout, or its arrays do not fit; names them.
        TypeError: an array does not hold numbers.
    """
    path = check_input(path)
    if path.suffix == ".npz":
        return replace(_read_npz(path), code=f"read_data({str(path)!r})")
    if is_buffer(path):
        state, action, ends = read_buffer(path, ("data/state", "data/obs"))
    elif tables(path):
        columns, ends = read_frames(path)
        state = np.hstack([columns[name] for name in OBSERVATIONS if name in columns])
        action = columns[ACTION]
    else:
        raise ValueError(f"{path} is of no known layout: expected {EXPECTED}")
    steps = f"observe={observe}, predict={predict}"
    rows = from_episodes(state, action, ends, observe=observe, predict=predict, name=path.name)
    return replace(rows, code=f"read_data({str(path)!r}, {steps})")


def from_arrays(
    x1: ArrayLike, c: ArrayLike, *, group: ArrayLike | None = None, name: str = "my data"
) -> Rows:
    """Convert arrays to rows; axes after the first are flattened.

    A vector c of strings, booleans or integers holds labels, which become one-hot; a vector of
    floating-point numbers becomes one column. A column of a matrix c is a number; where it may hold
    labels, `Rows.about` says so.

    Args:
        x1: (n, ...), the data to generate.
        c: (n, ...) numbers, or (n,) labels.
        group: (n,) integers or strings; every row is its own group if None.
        name: name of the data.

    Raises:
        TypeError: an array does not hold numbers.
        ValueError: shapes do not match, or values are not finite; says which and where.
    """
    condition = _numbers_or_strings(c, "c")
    labels = condition.ndim == 1 and condition.dtype.kind in "UiubS"
    if labels:
        found, index = np.unique(condition, return_inverse=True)
        if len(found) > MOST_LABELS:
            raise ValueError(
                f"c is a vector of {len(found)} different labels, at most {MOST_LABELS} are taken; "
                "if these are numbers, store them as floating point"
            )
        condition = np.eye(len(found))[index]
    data = Dataset(_numbers(x1, "x1"), _numbers(condition, "c"), name)
    k = data.condition_dim
    words = f"{k} labels" if labels else f"conditions of {_numbers_of(k)}{_maybe_labels(data.c)}"
    together = np.arange(len(data)) if group is None else _numbers_or_strings(group, "group")
    if together.shape != (len(data),):
        raise ValueError(f"group must have shape ({len(data)},), got {together.shape}")
    _, together = np.unique(together, return_inverse=True)
    return Rows(data, together, f"{len(data)} rows of {_numbers_of(data.dim)}, {words}")


def _numbers_of(count: int) -> str:
    return f"{count} number{'s' * (count != 1)}"


def from_episodes(
    state: ArrayLike, action: ArrayLike, ends: ArrayLike, *, observe: int, predict: int, name: str
) -> Rows:
    """Convert episodes to rows: the last states are the condition, the next actions are x1.

    There is one row per step; at the ends of an episode the first state and the last action are
    repeated. The rows of an episode form one group.

    Args:
        state: (N, s), one row per step.
        action: (N, a), the action taken in each state.
        ends: (E,), exclusive end of each episode.
        observe: number of states in c.
        predict: number of actions in x1.
        name: name of the data.
    """
    seen, done = _numbers(state, "state"), _numbers(action, "action")
    last = check_real(ends, "ends")
    check_same_rows(seen, "state", done, "action")
    rising = last.ndim == 1 and last.dtype.kind in "iu" and len(last) > 0
    if not rising or last[-1] != len(seen) or (np.diff(last.astype(int), prepend=0) < 1).any():
        raise ValueError(f"ends must rise to the number of rows {len(seen)}, got {last}")
    check_count(observe, "observe")
    check_count(predict, "predict")
    step = np.arange(len(seen))
    before, after, episode = window_rows(step, last, observe, predict)
    rows = from_arrays(done[after], seen[before], group=episode, name=name)
    about = f"{len(last)} episodes; {predict} actions given {observe} states; {rows.about}"
    return Rows(rows.data, rows.group, about)


def _maybe_labels(c: Tensor | None) -> str:
    """Words about columns of c (n, k) with 3 to 20 whole values, beside as many others.

    Two values are left out: one column of them says as much as two of one-hot labels.
    """
    if c is None or not 2 <= c.shape[1] <= MOST_LABELS:
        return ""
    whole = [i for i, column in enumerate(c.T) if torch.equal(column, column.round())]
    values = {i: len(c[:, i].unique()) for i in whole}
    few = {i: n for i, n in values.items() if 3 <= n <= min(FEW, len(c) // 3)}
    if 2 * len(few) > c.shape[1]:
        return ""
    hint = "if these are labels, make them one-hot"
    return "".join(f"; column {i} has {n} values: {hint}" for i, n in few.items())


def _numbers_or_strings(value: ArrayLike, name: str) -> NDArray[Any]:
    """An array of real numbers or strings; pandas and NumPy may hold strings as objects."""
    dtype = getattr(value, "dtype", None)
    if getattr(dtype, "kind", "") in ("O", "T"):
        items = np.asarray(value, dtype=object)
        if all(isinstance(item, str) for item in items.flat):
            return items.astype(str)
    return check_real(value, name, "fiubUS")


def _numbers(value: ArrayLike, name: str) -> Tensor:
    """Numbers as a finite float32 tensor (n, k)."""
    array = check_real(value, name)
    if array.size == 0 or array.ndim == 0:
        raise ValueError(f"{name} must have rows, got shape {array.shape}")
    rows = array.reshape(len(array), -1)
    check_matrix(torch.from_numpy(rows.astype(np.float64)), name)
    return check_matrix(check_single(rows, name), name)


def _read_npz(path: Path) -> Rows:
    with reading(path, "no .npz file"), path.open("rb") as file:
        start = file.read(2)
    if start != b"PK":
        raise ValueError(f"{path} is no .npz file, as numpy.savez writes it")
    with (
        reading(path, "no .npz file, or holds Python objects"),
        path.open("rb") as file,
        np.load(file, allow_pickle=False) as stored,
    ):
        arrays = {key: stored[key] for key in ("x1", "c", "group") if key in stored}
        names = stored.files
    if missing := [key for key in ("x1", "c") if key not in arrays]:
        raise ValueError(f"{path} has no array {' and no array '.join(missing)}; it has {names}")
    return from_arrays(**arrays, name=path.name)
