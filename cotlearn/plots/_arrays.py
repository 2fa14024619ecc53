"""Read what a figure is given: torch tensors, or anything that numpy understands."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = Any  #: NDArray[np.float64]; the stubs of matplotlib refuse arrays that it takes


def as_array(value: ArrayLike | Any, *shape: int | str) -> Array:
    """A float array from a tensor (any device) or anything numpy understands.

    Args:
        value: numbers.
        shape: of the array, say ``"n", 2``; a word stands for any size. Any shape by default.

    Raises:
        ValueError: another shape, which would draw something else than was meant.
    """
    if hasattr(value, "detach"):
        value = value.detach().cpu()
    array = np.asarray(value, dtype=np.float64)
    fits = len(shape) == array.ndim and all(
        isinstance(wanted, str) or wanted == size
        for wanted, size in zip(shape, array.shape, strict=True)
    )
    if shape and not fits:
        raise ValueError(
            f"expected an array of shape ({', '.join(map(str, shape))}), got {array.shape}"
        )
    return array


def read_condition(c: ArrayLike | Any, rows: int) -> tuple[NDArray[Any] | None, int]:
    """Read a condition: (class of each row, number of classes), (value of each row, 0), (None, 0).

    One-hot rows (n, K >= 2) and integer vectors (n,) are classes; (n, 1) and float vectors (n,)
    are values.

    Raises:
        ValueError: not one row for each point, or several columns that are not one-hot.
    """
    if c is None:
        return None, 0
    array = np.asarray(c.detach().cpu() if hasattr(c, "detach") else c)
    if len(array) != rows:
        raise ValueError(f"c has shape {array.shape}, expected one row for each of {rows} points")
    if array.ndim == 2 and array.shape[1] > 1:
        if not (np.isin(array, (0, 1)).all() and (array.sum(1) == 1).all()):
            raise ValueError(f"c has shape {array.shape} but is not one-hot; pass one value a row")
        return array.argmax(1), array.shape[1]
    if array.ndim == 1 and np.issubdtype(array.dtype, np.integer):
        return array, int(array.max(initial=0)) + 1
    return array.reshape(rows).astype(np.float64), 0
