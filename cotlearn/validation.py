"""Checks of arguments that every floor of the house shares.

Each check names the argument, what came and what was expected.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor


def check_matrix(value: Any, name: str, *, columns: int | None = None) -> Tensor:
    """Return `value` if it is a finite, non-empty floating-point tensor of shape (n, columns).

    Raises:
        TypeError: `value` is not a floating-point tensor.
        ValueError: it has another shape, no rows, or values that are not finite.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a torch tensor, got {type(value).__name__}")
    if not value.is_floating_point():
        raise TypeError(f"{name} must be a floating-point tensor, got {value.dtype}")
    if value.ndim != 2:
        raise ValueError(f"{name} must have shape (rows, columns), got {tuple(value.shape)}")
    if value.shape[0] == 0:
        raise ValueError(f"{name} is empty: it has 0 rows")
    if value.shape[1] == 0 and columns is None:
        raise ValueError(f"{name} is empty: it has 0 columns")
    if columns is not None and value.shape[1] != columns:
        raise ValueError(f"{name} has {value.shape[1]} columns, expected {columns}")
    if not math.isfinite(value.detach().sum()):  # quick; of large numbers the sum can be infinite
        bad = int((~torch.isfinite(value)).any(dim=1).sum())
        if bad:
            raise ValueError(f"{name} has NaN or infinite values in {bad} of {len(value)} rows")
    return value


def check_dtype(value: Tensor, name: str, wanted: torch.dtype) -> None:
    """Raise TypeError unless `value` is a tensor of the type of the numbers it meets."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a torch tensor, got {type(value).__name__}")
    if value.dtype != wanted:
        raise TypeError(f"{name} must have the type {wanted}, as the weights, got {value.dtype}")


def check_shape(value: Any, name: str, shape: tuple[int, ...]) -> Tensor:
    """Return `value` if it is a floating-point tensor of this shape, whatever its numbers."""
    if not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name} must be a floating-point tensor, got {got}")
    if value.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {tuple(value.shape)}")
    return value


def check_condition(value: Any, name: str = "c") -> Tensor:
    """Return a condition as a floating-point tensor of shape (n, k).

    Integer and bool tensors of shape (n, k) are taken as numbers; a vector of n labels is refused,
    because the distance between labels 1 and 7 means nothing: make it one-hot.
    """
    if isinstance(value, Tensor) and not value.is_floating_point() and not value.is_complex():
        value = value.to(torch.get_default_dtype())
    if isinstance(value, Tensor) and value.ndim == 1:
        raise ValueError(
            f"{name} must have shape (rows, columns), got {tuple(value.shape)}; "
            "for class labels use torch.nn.functional.one_hot, for one number per row c[:, None]"
        )
    return check_matrix(value, name)


def check_same_rows(first: Tensor, first_name: str, second: Tensor, second_name: str) -> None:
    """Raise ValueError unless both tensors have the same number of rows."""
    if not isinstance(second, Tensor) or not second.ndim:  # the first is checked already
        raise TypeError(f"{second_name} must be a torch tensor with rows, got {second!r}")
    if len(first) != len(second):
        raise ValueError(
            f"{first_name} has {len(first)} rows, {second_name} has {len(second)}: "
            "they must have the same number"
        )


def check_count(value: Any, name: str, *, minimum: int = 1) -> int:
    """Return `value` if it is an integer of at least `minimum` (True and 3.0 are not integers)."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise TypeError(f"{name} must be an integer, got {value!r}")
    number = value.__index__()
    if number < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {number}")
    return int(number)


def check_number(value: Any, name: str, *, minimum: float = 0.0, infinite: bool = False) -> float:
    """Return `value` as a float if it is a number of at least `minimum`, not NaN."""
    try:
        scalar = value.item() if hasattr(value, "item") else value  # of numpy or torch
    except (ValueError, RuntimeError):
        scalar = None
    if isinstance(scalar, bool) or not isinstance(scalar, int | float):
        raise TypeError(f"{name} must be a number, got {value!r}")
    number = float(scalar)
    if math.isnan(number) or number < minimum or (math.isinf(number) and not infinite):
        also = " (infinity is allowed)" if infinite else " and finite"
        raise ValueError(f"{name} must be at least {minimum:g}{also}, got {number}")
    return number


def check_share(value: Any, name: str) -> float:
    """Return `value` as a float if it is a number in [0, 1]."""
    if (share := check_number(value, name)) > 1:
        raise ValueError(f"{name} must lie in [0, 1], got {share}")
    return share


def check_choice(value: Any, name: str, choices: tuple[str, ...]) -> str:
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}; got {value!r}")
    return str(value)
