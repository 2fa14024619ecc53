"""Conditions in units of their own, so that no column decides alone because its numbers are large.

A distance of conditions adds the squares of all columns. A force in newtons or a time in seconds
then outweighs a label, and noise is skewed by the label without a word. So does a sentinel, as
-9999 for a missing value.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.datasets import Rows, Standardiser
from cotlearn.validation import check_condition

FAR = 16.0  #: spreads from the median beyond which distances grow like logarithms
SEVERAL = 6.0  #: spreads of the typical difference above which a column has several scales
KNOTS = 4096  #: most values of a column whose ranks are kept
PAIRS = 1024  #: random pairs of rows whose differences measure a spread
ROUNDING = 8  #: units in the last place below which values count as equal


@dataclass(frozen=True)
class OwnUnits:
    """Divides each column by its spread, the geometric mean of the differences of unequal rows.

    The geometric mean hardly moves if a few rows are far away: with 2 % of the rows at a distance
    of 10,000 it grows by 40 %, a standard deviation 1,400-fold. Of a column with two values it is
    their difference, so that one-hot labels stay as they are, however often each label occurs.
    Values z spreads from the median, z above 16, are drawn to 16 + log(z / 16); none merge.

    No spread fits a column of several scales: a switch with a jitter of a thousandth, a sensor with
    many sentinels, powers of ten. Its typical difference would be many spreads, so that it would
    outweigh the others. Such a column is replaced by twice the mid-rank of its values, from 0 to 2,
    in which two values differ by 1 as well.

    Attributes:
        centre: (k,), the median of each column; float64.
        spread: (k,), exactly 0 for a constant column.
        ranked: (r,), the columns of several scales.
        knots: (r, m), their sorted values, at most 4,096.
    """

    centre: Tensor
    spread: Tensor
    ranked: Tensor
    knots: Tensor

    @classmethod
    def fit(cls, c: Tensor) -> OwnUnits:
        """Measure the columns of c (n, k) on 1,024 pairs of rows, the same for equal n."""
        c = check_condition(c)
        values = c.detach().to("cpu", torch.float64)
        first, second = _pairs(len(c))
        rounding = ROUNDING * torch.finfo(c.dtype).eps
        some, others = values[first], values[second]
        unequal, size = (some - others).abs(), torch.maximum(some.abs(), others.abs())
        usual = torch.where(size > 0, size, torch.nan).nanmedian(dim=0).values.nan_to_num(0.0)
        differ = unequal > rounding * torch.maximum(size, usual)
        spread = _geometric_mean(unequal, differ)
        reach = values.amax(dim=0) - values.amin(dim=0)  # if no pair met the few unequal rows
        reach = torch.where(reach > rounding * values.abs().amax(dim=0), reach, 0.0)
        spread = torch.where(differ.any(dim=0), spread, reach)
        centre, none = some.median(dim=0).values, torch.zeros(0)
        units = cls(centre, spread, none.long(), none)
        typical = _mean((units(some) - units(others)).square(), differ).sqrt()
        ranked = (typical > SEVERAL).nonzero()[:, 0]
        return cls(centre, spread, ranked, _knots(values[:, ranked]))

    def __call__(self, c: Tensor) -> Tensor:
        """The columns in units of their own, (n, k), float64; constant columns become 0."""
        z = self._far_from_centre(c)
        return self._with_ranks(c, torch.where(z.abs() > FAR, _drawn(z), z))

    def tamed(self, c: Tensor) -> Tensor:
        """C (n, k) with far values drawn near, and ranks for columns of several scales.

        The other columns keep their units; if there is nothing to do, c itself is returned.
        """
        c = check_condition(c)
        z = self._far_from_centre(c)
        far = z.abs() > FAR
        if not (far.any() or len(self.ranked)):
            return c
        centre, spread = self.centre.to(c.device), self.spread.to(c.device)
        near = torch.where(far, (centre + spread * _drawn(z)).to(c.dtype), c)
        return self._with_ranks(c, near)

    def _far_from_centre(self, c: Tensor) -> Tensor:
        centre, spread = self.centre.to(c.device), self.spread.to(c.device)
        return (c.detach().double() - centre) * (spread > 0) / (spread + (spread == 0))

    def _with_ranks(self, c: Tensor, near: Tensor) -> Tensor:
        """`near` with twice the mid-ranks of c in the columns of several scales."""
        if not len(self.ranked):
            return near
        ranked, knots = self.ranked.to(c.device), self.knots.to(c.device)
        values = c.detach()[:, ranked].double().T.contiguous()
        below = torch.searchsorted(knots, values)
        up_to = torch.searchsorted(knots, values, right=True)
        return near.index_copy(1, ranked, ((below + up_to) / knots.shape[1]).T.to(near))


@dataclass(frozen=True)
class TamedStandardiser:
    """A `Standardiser` for values of which those far from all others are drawn near first.

    A column with 2 % of its rows at -9999 has a deviation of 1,400, after which its other values
    are all but equal to each other, and a network cannot see them.

    Attributes:
        units: of the columns as they are.
        scaler: of the columns after that.
    """

    units: OwnUnits
    scaler: Standardiser

    @classmethod
    def fit(cls, c: Rows) -> TamedStandardiser:
        """Measure the columns of c (n, k), a tensor or an array."""
        values = torch.as_tensor(c)
        units = OwnUnits.fit(values)
        return cls(units, Standardiser.fit(units.tamed(values)))

    def __call__(self, c: Rows) -> Rows:
        """Standardise c (n, k), a tensor or an array."""
        scaled = self.scaler(self.units.tamed(torch.as_tensor(c)))
        return scaled if isinstance(c, Tensor) else scaled.numpy()


def tamed(c: Tensor) -> Tensor:
    """C (n, k) with far values drawn near, and several scales ranked; see `OwnUnits.tamed`."""
    return OwnUnits.fit(c).tamed(c)


def _geometric_mean(values: Tensor, counted: Tensor) -> Tensor:
    return _mean(torch.where(counted, values, 1.0).log(), counted).exp()


def _mean(values: Tensor, counted: Tensor) -> Tensor:
    """The mean of the counted values (n, k) of each column, (k,); 0 if none is counted."""
    return torch.where(counted, values, 0.0).sum(dim=0) / counted.sum(dim=0).clamp(min=1)


def _knots(values: Tensor) -> Tensor:
    """At most 4,096 values of each column of (n, r), sorted and evenly spaced in rank, (r, m)."""
    places = torch.linspace(0, len(values) - 1, min(len(values), KNOTS)).round().long()
    return values.T.sort(dim=1).values[:, places].contiguous()


def _drawn(z: Tensor) -> Tensor:
    return z.sign() * (FAR + (z.abs().clamp(min=FAR) / FAR).log())


@functools.lru_cache(maxsize=16)
def _pairs(rows: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Random pairs of different rows."""
    rng = np.random.default_rng(0)
    first = rng.integers(rows, size=PAIRS)
    return first, (first + rng.integers(1, max(2, rows), size=PAIRS)) % rows
