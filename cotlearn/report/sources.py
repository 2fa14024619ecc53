"""Reads your own data: arrays, an .npz, a LeRobot folder, a Diffusion Policy zarr."""

import difflib
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.diagnostics.groups import numbered
from cotlearn.files import check_input, reading
from cotlearn.robots.episodes.checked import LONGEST, window_rows
from cotlearn.robots.episodes.lerobot import OBSERVATIONS, read_frames, tables
from cotlearn.robots.episodes.replay import is_buffer, read_buffer
from cotlearn.robots.layout import ACTION
from cotlearn.validation import (
    check_count,
    check_matrix,
    check_real,
    check_same_rows,
    check_single,
    counted,
    short,
)

MOST_LABELS = 64  #: distinct values of a vector of labels
KEYS = "x1", "c", "group"  #: arrays of an .npz
FEW = 20  #: distinct whole values of a column that may be labels
NAMED = 5  #: columns that a note names
EXPECTED = "an .npz with x1 and c, a LeRobot folder, or a Diffusion Policy .zarr"


@dataclass(frozen=True)
class Rows:
    """A data set and its groups of rows that belong together.

    Attributes:
        data: x1 (n, d) and c (n, k), float32.
        group: (n,), rows with the same number are never split between training and test.
        about: where it comes from, a few words.
        code: Python that reads it again from its file; empty if it came as arrays.
        notes: what to look at before the numbers are believed, a sentence each.
        labels: the label of each column of c, if c came as a vector of labels.
    """

    data: Dataset
    group: NDArray[np.int64]
    about: str
    code: str = ""
    notes: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()


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
    floating-point numbers becomes one column. A column of a matrix c is a number. `Rows.notes` says
    where it may hold labels, where c does not vary, and how many rows are copies.

    Args:
        x1: (n, ...), the data to generate.
        c: (n, ...) numbers, or (n,) labels.
        group: (n,) integers or strings; if None, every row is its own group, but rows that are
            equal in x1 and c share one.
        name: name of the data.

    Raises:
        TypeError: an array does not hold numbers, or c holds text in a matrix.
        ValueError: shapes do not match, or values are not finite; says which and where.
    """
    condition = _numbers_or_labels(c)
    labels: tuple[str, ...] = ()
    if condition.ndim == 1 and condition.dtype.kind in "UiubS":
        found, index = np.unique(condition, return_inverse=True)
        if len(found) > MOST_LABELS:
            raise ValueError(
                f"c is a vector of {len(found)} different labels, at most {MOST_LABELS} are taken; "
                "if these are numbers, store them as floating point"
            )
        names = (
            one.decode(errors="replace") if isinstance(one, bytes) else one
            for one in found.tolist()
        )
        condition, labels = np.eye(len(found))[index], tuple(map(str, names))
    values, given = _numbers(x1, "x1"), _numbers(condition, "c")
    data = Dataset(values, given, name)
    k, equal = data.condition_dim, _equal_rows(torch.hstack([values, given]))
    words = counted(k, "label") if labels else f"conditions of {counted(k, 'number')}"
    together = equal if group is None else _numbers_or_strings(group, "group")
    if together.dtype.kind == "f" and not np.isfinite(together).all():
        raise ValueError("group must be finite, got NaN or infinity")
    if together.shape != (len(data),):
        raise ValueError(f"group must have shape ({len(data)},), got {together.shape}")
    if group is not None:
        _, together = np.unique(together, return_inverse=True)
    copies = _copies(equal) if group is None else _copies_apart(equal, together)
    notes = (*_constant(given), *_maybe_labels(given), *copies)
    about = f"{len(data)} rows of {counted(data.dim, 'number')}, {words}"
    return Rows(data, together, about, notes=notes, labels=labels)


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
        observe: number of states in c, at most 10,000.
        predict: number of actions in x1, at most 10,000.
        name: name of the data.
    """
    seen, done = _numbers(state, "state"), _numbers(action, "action")
    last = check_real(ends, "ends")
    check_same_rows(seen, "state", done, "action")
    rising = last.ndim == 1 and last.dtype.kind in "iu" and len(last) > 0
    if not rising or last[-1] != len(seen) or (np.diff(last.astype(int), prepend=0) < 1).any():
        raise ValueError(f"ends must rise to the number of rows {len(seen)}, got {last}")
    check_count(observe, "observe", most=LONGEST)
    check_count(predict, "predict", most=LONGEST)
    step = np.arange(len(seen))
    before, after, episode = window_rows(step, last, observe, predict)
    rows = from_arrays(done[after], seen[before], group=episode, name=name)
    about = f"{len(last)} episodes; {predict} actions given {observe} states; {rows.about}"
    return replace(rows, about=about)


def _constant(c: Tensor) -> list[str]:
    """A note on columns of c (n, k) that do not vary."""
    varies = (c != c[0]).any(dim=0).tolist()
    if not any(varies):
        return ["c does not vary: every coupling is then one without a condition"]
    still = [str(i) for i, column_varies in enumerate(varies) if not column_varies]
    if len(still) < 2:
        return [f"column {i} of c does not vary: leave it out" for i in still]
    more = f" and {len(still) - NAMED} more" if len(still) > NAMED else ""
    return [f"columns {', '.join(still[:NAMED])}{more} of c do not vary: leave them out"]


def _maybe_labels(c: Tensor) -> list[str]:
    """Notes on columns of c (n, k) with 3 to 20 whole values: the only one, or beside as many more.

    Two values are left out: one column of them says as much as two of one-hot labels.
    """
    if c.shape[1] > MOST_LABELS:
        return []
    whole = [i for i, column in enumerate(c.T) if torch.equal(column, column.round())]
    values = {i: len(c[:, i].unique()) for i in whole}
    few = {i: n for i, n in values.items() if 3 <= n <= min(FEW, len(c) // 3)}
    if len(few) > max(1, c.shape[1] // 2):
        return []
    hint = "if these are labels, make them one-hot"
    return [f"column {i} of c has {n} values: {hint}" for i, n in few.items()]


def _equal_rows(values: Tensor) -> NDArray[np.int64]:
    """A number for each row of values (n, m), the same for equal rows, from 0 on."""
    plain = values.numpy() + 0.0  # no -0.0, whose bytes differ
    return numbered(plain.view(f"V{plain.itemsize * plain.shape[1]}")[:, 0], len(plain))


def _copies(equal: NDArray[np.int64]) -> list[str]:
    """A note on rows that share their number (n,) with an earlier one, and so its group."""
    copies = len(equal) - (int(equal.max()) + 1)
    if not copies:
        return []
    return [
        f"rows that repeat another one, in x1 and in c: {copies} of {len(equal)}; equal rows are "
        "held out together, unless group is given, but the intervals count each of them, and are "
        "too narrow: leave copies out"
    ]


def _copies_apart(equal: NDArray[np.int64], group: NDArray[np.int64]) -> list[str]:
    """A note on rows of one number (n,) in several groups (n,), as they were given."""
    places = np.unique(np.stack([equal, group]), axis=1)[0]
    apart = int((np.bincount(places) > 1)[equal].sum())
    if not apart:
        return []
    return [
        f"rows that repeat one of another group, in x1 and in c: {apart} of {len(equal)}; leave "
        "copies out or give them one group, else the scores are too good"
    ]


def _numbers_or_labels(c: ArrayLike) -> NDArray[Any]:
    """An array of real numbers, or a vector of strings.

    Raises:
        TypeError: c holds something else, or text in a matrix.
    """
    array = check_real(c, "c", "fiubUSOT")
    items = array.astype(object).flat if array.ndim > 1 and array.dtype.kind in "USOT" else ()
    if any(isinstance(item, str | bytes) for item in items):
        raise TypeError(
            f"c must hold numbers or be a vector of labels, got text in shape {array.shape}: make "
            "each column of text one-hot, beside the numbers, or pass one alone, as a vector"
        )
    return _numbers_or_strings(c, "c")


def _numbers_or_strings(value: ArrayLike, name: str) -> NDArray[Any]:
    """An array of real numbers or strings; pandas and NumPy may hold strings as objects.

    Raises:
        TypeError: it holds something else.
    """
    array = check_real(value, name, "fiubUSOT")
    if array.dtype.kind not in "OT":
        return array
    items = array.astype(object)
    others = [item for item in items.flat if not isinstance(item, str)]
    if others:
        odd = next((item for item in others if not isinstance(item, Real)), others[0])
        got = f"objects such as {short(odd)}" if array.ndim else short(value)
        raise TypeError(f"{name} must hold real numbers or strings, got {got}")
    return items.astype(str)


def _numbers(value: ArrayLike, name: str) -> Tensor:
    """Numbers as a finite float32 tensor (n, k)."""
    array = check_real(value, name)
    if array.size == 0 or array.ndim == 0:
        raise ValueError(f"{name} must have rows, got shape {array.shape}")
    rows = array.reshape(len(array), -1)
    check_matrix(torch.from_numpy(rows.astype(np.float64)), name)
    return check_matrix(check_single(rows, name), name)


def _stored(file: Any, key: str) -> NDArray[Any] | None:
    """An array of an .npz file, of numbers or words; None if it holds Python objects."""
    try:
        array: NDArray[Any] = file[key]
    except ValueError as error:
        if "Object arrays" not in str(error):
            raise
        return None
    return array


def _read_npz(path: Path) -> Rows:
    with reading(path, "no .npz file"), path.open("rb") as file:
        start = file.read(2)
    if start != b"PK":
        raise ValueError(f"{path} is no .npz file, as numpy.savez writes it")
    with (
        reading(path, "no .npz file"),
        path.open("rb") as file,
        np.load(file, allow_pickle=False) as stored,
    ):
        names = stored.files
        found = {key: _stored(stored, key) for key in KEYS if key in names}
    unread = [name for name in names if name not in KEYS]
    for key in (key for key in KEYS if key not in found):
        if near := difflib.get_close_matches(key, unread, n=1, cutoff=0.8):
            raise ValueError(f"{path} has an array {near[0]}, which is not read: call it {key}")
    if objects := [key for key, value in found.items() if value is None]:
        key = objects[0]
        raise ValueError(
            f"{path}: {key} holds Python objects, which are never loaded; fill what is None, and "
            f"save words as {key}.astype(str), numbers as {key}.astype(float)"
        )
    arrays = {key: value for key, value in found.items() if value is not None}
    if missing := [key for key in ("x1", "c") if key not in arrays]:
        raise ValueError(f"{path} has no array {' and no array '.join(missing)}; it has {names}")
    rows = from_arrays(**arrays, name=path.name)
    if unread:
        rows = replace(rows, notes=(*rows.notes, f"Not read: {', '.join(unread)}."))
    return rows
