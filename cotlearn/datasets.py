"""Finite data sets, scikit-learn's data as conditional tasks, and data without their condition."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor

from cotlearn import validation

Array = NDArray[Any]
Rows = Any  #: a tensor or an array of shape (rows, columns)


@dataclass(frozen=True)
class Standardiser:
    """Scales columns to mean 0 and standard deviation 1, and back; constant columns become 0.

    Attributes:
        mean: (k,), mean of each column.
        std: (k,), standard deviation of each column, exactly 0 for a constant column.
    """

    mean: Rows
    std: Rows

    @classmethod
    def fit(cls, rows: Rows) -> Standardiser:
        """Take mean and population standard deviation from rows (n, k), a tensor or an array."""
        if not isinstance(rows, Tensor):
            rows = np.ascontiguousarray(validation.check_array(rows, "rows", (None, None)))
        rows = rows.detach() if isinstance(rows, Tensor) else rows
        validation.check_squares(rows=validation.check_matrix(torch.as_tensor(rows), "rows"))
        varies = (rows != rows[0]).any(0)  # rounding can give constant columns a std above 0
        if not isinstance(rows, Tensor):
            return cls(rows.mean(0), rows.std(0) * varies)
        wide = rows if rows.device.type == "mps" else rows.double()  # sums of many rows round
        std = wide.std(0, unbiased=False).to(rows.dtype)
        return cls(wide.mean(0).to(rows.dtype), std * varies)

    def __call__(self, rows: Rows) -> Rows:
        """Standardise rows (n, k)."""
        rows = self._like(rows)
        varies = self.std > 0
        return (rows - self.mean) * varies / (self.std + ~varies)

    def inverse(self, rows: Rows) -> Rows:
        """Return standardised rows (n, k) to the units of the data."""
        return self._like(rows) * self.std + self.mean

    def _like(self, rows: Rows) -> Rows:
        """The rows, as the mean a tensor or an array, if they have its columns."""
        if not isinstance(rows, Tensor | np.ndarray):
            rows = validation.check_array(rows, "rows", (None, None))
        if rows.ndim != 2 or rows.shape[1] != len(self.mean):
            got = tuple(rows.shape)
            raise ValueError(f"rows must have shape (rows, {len(self.mean)}), got {got}")
        if isinstance(self.mean, Tensor) != isinstance(rows, Tensor):
            fitted, given = (type(part).__name__ for part in (self.mean, rows))
            raise TypeError(f"rows must be a {fitted}, as those of the fit, got {given}")
        return rows


@dataclass(frozen=True)
class Dataset:
    """Rows x1 with conditions c, sampled with replacement.

    Attributes:
        x1: (N, d), floating point and finite.
        c: (N, k), or None if there is no condition.
        name: label in figures and checkpoints.
    """

    x1: Tensor
    c: Tensor | None = None
    name: str = "dataset"

    def __post_init__(self) -> None:
        validation.check_without_gradient(validation.check_matrix(self.x1, "x1"), "x1")
        if self.c is not None:
            c = validation.check_without_gradient(validation.check_condition(self.c), "c")
            if c is not self.c:  # of other numbers it is a copy: then both are
                object.__setattr__(self, "x1", self.x1.clone())
            object.__setattr__(self, "c", c)
            validation.check_same_rows(self.x1, "x1", self.c, "c")

    def __len__(self) -> int:
        return len(self.x1)

    @property
    def dim(self) -> int:
        """d, the dimension of x1."""
        return self.x1.shape[1]

    @property
    def condition_dim(self) -> int:
        """k, the dimension of c; 0 without a condition."""
        return 0 if self.c is None else self.c.shape[1]

    def sample(self, n: int, generator: Generator | None = None) -> tuple[Tensor, Tensor | None]:
        """Draw n rows with replacement: x1 of shape (n, d) and c of shape (n, k), or None."""
        validation.check_generator(generator)
        rows = torch.randint(len(self), (validation.check_count(n, "n"),), generator=generator)
        return self.x1[rows], None if self.c is None else self.c[rows]

    def sample_given(self, c: Tensor, generator: Generator | None = None) -> Tensor:
        """For each row of c (n, k) draw a data row with exactly that condition, shape (n, d).

        Within one condition, rows are drawn without replacement until all have been drawn.

        Raises:
            ValueError: no data row has the condition, or the data have no conditions.
        """
        if self.c is None:
            raise ValueError("this data set has no condition: use sample(n)")
        c = validation.check_condition(c, columns=self.condition_dim)
        validation.check_generator(generator)
        wanted, index = torch.unique(c, dim=0, return_inverse=True)
        x1 = torch.empty(len(c), self.dim, dtype=self.x1.dtype)
        for i, condition in enumerate(wanted):
            rows = (self.c == condition).all(dim=1).nonzero()[:, 0]
            if len(rows) == 0:
                raise ValueError(f"c: no row of {self.name} has condition {condition.tolist()}")
            places = (index == i).nonzero()[:, 0]
            rounds = -(-len(places) // len(rows))
            order = [torch.randperm(len(rows), generator=generator) for _ in range(rounds)]
            x1[places] = self.x1[rows[torch.cat(order)[: len(places)]]]
        return x1

    def conditions(self, n: int = 9) -> Tensor:
        """The distinct conditions if there are at most 64, else n rows of c, evenly spaced."""
        if self.c is None:
            raise ValueError("this data set has no condition")
        validation.check_count(n, "n")
        distinct = torch.unique(self.c, dim=0).flip(0)
        if len(distinct) <= 64:
            return distinct
        return self.c[torch.linspace(0, len(self) - 1, n).long()]


@dataclass(frozen=True)
class Unconditional:
    """Data without their condition: `sample` returns (x1, None)."""

    data: Any
    name: str
    dim: int
    condition_dim = 0

    def sample(self, n: int, generator: Generator | None = None) -> tuple[Tensor, None]:
        """Draw n rows x1 of shape (n, d); the condition is None."""
        return self.data.sample(n, generator)[0], None


def unconditional(data: Any) -> Unconditional | Dataset:
    """Remove the condition of `data`; a `Dataset` stays a `Dataset`."""
    validation.check_has(data, "data", "data such as mixtures.petals()", "sample", "name", "dim")
    name = f"{data.name} without condition"
    if type(data) is Dataset:
        return Dataset(data.x1, None, name)
    return Unconditional(data, name, int(data.dim))


def digits(split: str = "all") -> Dataset:
    """scikit-learn's handwritten digits: 1,797 images of 8 x 8 pixels with one-hot labels.

    x1 has shape (n, 64), with grey values scaled from 0..16 to [-1, 1]; c is one-hot, (n, 10).

    Args:
        split: "all", "test" (every fourth image) or "train" (the other images).
    """
    from sklearn.datasets import load_digits

    validation.check_choice(split, "split", ("train", "test", "all"))
    images, labels = load_digits(return_X_y=True)
    x1 = torch.tensor(images, dtype=torch.float32) / 8 - 1
    c = torch.eye(10)[torch.tensor(labels)]
    held_out = torch.arange(len(x1)) % 4 == 3
    rows = {"train": ~held_out, "test": held_out, "all": torch.ones_like(held_out)}[split]
    return Dataset(x1[rows], c[rows], name="digits")
