"""What the checks of the homework share: shapes, and wrong answers that are recognised."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.homework.registry import NotYet

Array = NDArray[np.float64]


def expect_function(answer: Any) -> None:
    """Raises `NotYet` unless the answer can be called."""
    if not callable(answer):
        raise NotYet(f"expected a function, got {type(answer).__name__}")


def tensor(value: Any, shape: tuple[int, ...], what: str) -> Tensor:
    """Returns the value as float64 if it is a finite tensor of this shape.

    Args:
        value: What an answer returned.
        shape: Expected.
        what: The words for it, as "the loss, one value a row,".
    """
    if not isinstance(value, Tensor):
        raise NotYet(f"{what} must be a tensor of shape {shape}, got {type(value).__name__}")
    if tuple(value.shape) != shape:
        raise NotYet(f"{what} must have shape {shape}, got {tuple(value.shape)}")
    if not torch.isfinite(value).all():
        raise NotYet(f"{what} holds values that are not finite (nan or inf)")
    return value.detach().double()


def array(value: Any, shape: tuple[int, ...], what: str) -> Array:
    """Like `tensor`, for numpy."""
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise NotYet(f"{what} must be an array of shape {shape}") from None
    if found.shape != shape:
        raise NotYet(f"{what} must have shape {shape}, got {found.shape}")
    if not np.isfinite(found).all():
        raise NotYet(f"{what} holds values that are not finite (nan or inf)")
    return found


def number(value: Any) -> float:
    """Returns the value as a number."""
    try:
        return float(value)
    except (TypeError, ValueError, RuntimeError):
        raise NotYet(f"return one number, got {type(value).__name__}") from None


def same(a: ArrayLike | Tensor, b: ArrayLike | Tensor, *, tolerance: float = 1e-4) -> bool:
    """Whether two results are equal up to rounding."""
    left, right = (np.asarray(value, dtype=np.float64) for value in (a, b))
    return left.shape == right.shape and np.allclose(left, right, rtol=tolerance, atol=tolerance)


def compare(
    found: ArrayLike | Tensor,
    right: ArrayLike | Tensor,
    mistakes: Iterable[tuple[ArrayLike | Tensor, str]],
    otherwise: str,
    *,
    tolerance: float = 1e-4,
) -> None:
    """Raises `NotYet` unless `found` is right, with the hint of the mistake that it equals.

    Args:
        found: What an answer returned.
        right: What it should be.
        mistakes: Pairs of a wrong result and the sentence for it.
        otherwise: The sentence for all others.
        tolerance: Relative and absolute.
    """
    if same(found, right, tolerance=tolerance):
        return
    for wrong, hint in mistakes:
        if same(found, wrong, tolerance=tolerance):
            raise NotYet(hint)
    raise NotYet(otherwise)
