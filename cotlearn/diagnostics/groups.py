"""Rows that belong together, as those of one episode: they are held out together, or not at all."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.randomness import generator_for
from cotlearn.validation import check_real


def numbered(groups: Any, n: int) -> NDArray[np.intp]:
    """The groups of n rows as numbers from 0 on, (n,); each row is one of its own if None.

    Raises:
        TypeError: groups are not numbers or strings.
        ValueError: groups has not one value for each row, or one that is NaN.
    """
    if groups is None:
        return np.arange(n)
    found = check_real(groups, "groups", "fiubUSOV")  # V: bytes of rows, by `from_arrays`
    if found.dtype.kind == "O":
        if not all(isinstance(value, str) for value in found.flat):
            raise TypeError("groups must hold numbers or strings, got other objects")
        found = found.astype(str)
    if found.dtype.kind == "f" and not np.isfinite(found).all():
        raise ValueError("groups must be finite, got NaN or infinity")
    if found.shape != (n,):
        raise ValueError(f"groups must have one value for each of {n} rows, got {found.shape}")
    _, first, number = np.unique(found, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[number]  # in the order of their first rows


def held_out(x1: Tensor, c: Tensor, seed: int, groups: Any = None) -> tuple[Dataset, Dataset]:
    """Three quarters of the groups, of whose rows couplings make pairs, and those held out.

    Raises:
        ValueError: there are fewer than four groups.
    """
    group = torch.from_numpy(numbered(groups, len(x1)))
    number = int(group.max()) + 1
    if number < 4:
        raise ValueError(f"groups has {number} different values: at least 4 are needed")
    out = (torch.randperm(number, generator=generator_for(seed, 0)) < number // 4)[group]
    return Dataset(x1[~out], c[~out]), Dataset(x1[out], c[out])
