"""Read what a figure is given: torch tensors or anything numpy understands, or a clear refusal."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def as_array(value: ArrayLike | Any, name: str) -> NDArray[np.float64]:
    """A float array from a tensor (any device) or anything numpy understands."""
    if value is None:
        raise ValueError(f"{name} is None, expected a tensor or an array")
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is not an array of numbers: {error}") from None


def as_points(value: ArrayLike | Any, name: str, *, rows: int | None = None) -> NDArray[np.float64]:
    """Points in the plane, (n, 2), with so many ``rows`` where that is given."""
    array = as_array(value, name)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{name} has shape {array.shape}, expected (n, 2)")
    if rows is not None and len(array) != rows:
        raise ValueError(f"{name} has {len(array)} rows, expected {rows}")
    return array


def as_path(value: ArrayLike | Any, name: str) -> NDArray[np.float64]:
    """Paths in the plane, (times, n, 2) with two times or more."""
    array = as_array(value, name)
    if array.ndim != 3 or array.shape[2] != 2 or array.shape[0] < 2:
        raise ValueError(f"{name} has shape {array.shape}, expected (times >= 2, n, 2)")
    return array


def as_classes(c: ArrayLike | Any, rows: int) -> tuple[NDArray[Any] | None, int]:
    """Read a condition: (class of each row, number of classes), (value of each row, 0), (None, 0).

    One-hot rows (n, K >= 2) and integer vectors (n,) are classes; (n, 1) and float vectors (n,)
    are values.
    """
    if c is None:
        return None, 0
    array = as_array(c, "c")
    if array.ndim not in (1, 2) or len(array) != rows or array.shape[-1] == 0:
        raise ValueError(f"c has shape {array.shape}, expected ({rows},) or ({rows}, k)")
    if array.ndim == 2 and array.shape[1] > 1:
        one_hot = np.isin(array, (0.0, 1.0)).all() and (array.sum(1) == 1).all()
        if not one_hot:
            raise ValueError(f"c has shape {array.shape} but is not one-hot; pass one value a row")
        return array.argmax(1), array.shape[1]
    values = array.reshape(rows)
    raw = c.detach().cpu().numpy() if hasattr(c, "detach") else np.asarray(c)
    if raw.ndim == 1 and np.issubdtype(raw.dtype, np.integer):
        if rows and values.min() < 0:
            raise ValueError("c has negative classes, expected integers from 0")
        return values.astype(int), int(values.max(initial=0)) + 1
    return values, 0


def refuse_unknown(given: Iterable[str] | None, name: str, known: Iterable[str]) -> None:
    """Refuse an argument with names that are not among the known ones."""
    known = list(known)
    unknown = sorted(set(given or ()) - set(known))
    if unknown:
        raise ValueError(f"{name} has {unknown}, expected names among {known}")
