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

from cotlearn.couplings.distances import Array, to_numpy
from cotlearn.datasets import Rows, Standardiser
from cotlearn.validation import check_condition

Mask = NDArray[np.bool_]

FAR = 16.0  #: spreads from the median beyond which distances grow like logarithms
SEVERAL = 6.0  #: spreads of the typical difference above which a column has several scales
SMALL, OFTEN = 0.16, 0.08  #: and those below which it has, if this share of differences is smaller
GAP, RARE = 1.0, 0.02  #: and a gap of so many spreads, with more than so few rows on each side
CODES = 64  #: and at most so many values, or one value in more than a share `OFTEN` of the rows
KNOTS = 4096  #: most values of a column whose ranks are kept
PAIRS = 1024  #: random pairs of rows whose differences measure a spread
ROUNDING = 8  #: units in the last place below which values count as equal
ROUNDING_NEAR = 2  #: the same in a column whose values lie near each other
NEAR = 128  #: units in the last place within which they do


@dataclass(frozen=True)
class OwnUnits:
    """Divides each column by its spread, the geometric mean of the differences of unequal rows.

    The geometric mean hardly moves if a few rows are far away: with 2 % of the rows at a distance
    of 10,000 it grows by 40 %, a standard deviation 1,400-fold. Of a column with two values it is
    their difference, so that one-hot labels stay as they are, however often each label occurs.
    Values z spreads from the median, z above 16, are drawn to 16 + log(z / 16); none merge.

    No spread fits a column of several scales: a switch with a jitter of a thousandth, a sensor with
    many sentinels, powers of ten, a flag with 99 for a missing value. Its typical difference would
    be many spreads, so that it would outweigh the others, or many differences a small part of one,
    so that nothing would heed them. Such a column is replaced by twice the mid-rank of its values,
    from 0 to 2, in which two values differ by 1 as well.

    Values that differ by rounding count as equal: by 8 units in the last place, and by 2 in a
    column whose values lie within 128 of them, as 0.95 and 1 do in bfloat16. Whole numbers are
    exact.

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
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that no rule can pair by
            return cls._measured(to_numpy(c), c.dtype)

    @classmethod
    def _measured(cls, values: Array, dtype: torch.dtype) -> OwnUnits:
        """In NumPy: a batch is small, and each call of torch takes longer than its work."""
        first, second = values[_pairs(len(values))]  # each (pairs, k)
        reach, largest = np.ptp(values, axis=0), np.abs(values).max(axis=0)
        eps = torch.finfo(dtype).eps
        rounding = eps * np.where(reach <= NEAR * eps * largest, ROUNDING_NEAR, ROUNDING)
        rounding[(values == np.rint(values)).all(axis=0)] = 0.0  # whole numbers are exact
        unequal, size = np.abs(first - second), np.maximum(np.abs(first), np.abs(second))
        differ = unequal > rounding * np.maximum(size, _median(size, size > 0))
        usual = np.exp(_mean(np.log(np.where(differ, unequal, 1.0)), differ))
        # if no pair met the few unequal rows
        reach = np.where(reach > rounding * largest, reach, 0.0)
        spread = np.where(differ.any(axis=0), usual, reach)
        centre = _median(first, np.isfinite(first))
        apart = _near(_scaled(first, centre, spread)) - _near(_scaled(second, centre, spread))
        small = _lower(unequal, differ, OFTEN) < SMALL * spread
        for column in np.flatnonzero(small):
            small[column] = _holds_codes(first[:, column], spread[column])
        several = np.flatnonzero(small | (np.sqrt(_mean(np.square(apart), differ)) > SEVERAL))
        ranked = torch.from_numpy(several)
        knots = _knots(torch.from_numpy(values)[:, ranked]) if len(several) else torch.zeros(0, 0)
        return cls(torch.from_numpy(centre), torch.from_numpy(spread), ranked, knots)

    def __call__(self, c: Tensor) -> Tensor:
        """The columns in units of their own, (n, k), float64; constant columns become 0."""
        return self._with_ranks(c, torch.from_numpy(_near(self._spreads_away(c))).to(c.device))

    def tamed(self, c: Tensor) -> Tensor:
        """C (n, k) with far values drawn near, and ranks for columns of several scales.

        The other columns keep their units; if there is nothing to do, c itself is returned.
        """
        c = check_condition(c)
        z = self._spreads_away(c)
        far = np.abs(z) > FAR
        if not (far.any() or len(self.ranked)):
            return c
        drawn = torch.from_numpy(self.centre.numpy() + self.spread.numpy() * _drawn(z))
        near = torch.where(torch.from_numpy(far).to(c.device), drawn.to(c), c)
        return self._with_ranks(c, near)

    def _spreads_away(self, c: Tensor) -> Array:
        """The columns of c (n, k), in spreads from their median."""
        if c.shape[-1] != len(self.centre):
            raise ValueError(f"c has {c.shape[-1]} columns, expected {len(self.centre)}")
        return _scaled(to_numpy(c), self.centre.numpy(), self.spread.numpy())

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


@np.errstate(over="ignore", invalid="ignore")
def _scaled(values: Array, centre: Array, spread: Array) -> Array:
    """Values (n, k) in spreads from the centre; 0 where there is no spread."""
    scaled: Array = (values - centre) / np.where(spread > 0, spread, np.inf)
    return scaled


def _mean(values: Array, counted: Mask) -> Array:
    """The mean of the counted values (n, k) of each column, (k,); 0 if none is counted."""
    return np.where(counted, values, 0.0).sum(axis=0) / np.maximum(counted.sum(axis=0), 1)


def _holds_codes(values: Array, spread: float) -> bool:
    """Whether values (n,) are codes, or have one far away as for what is missing."""
    few = int(RARE * len(values))
    middle = np.sort(values)[few : len(values) - few]
    _, count = np.unique(middle, return_counts=True)
    coded = len(count) <= CODES or count.max() > OFTEN * len(values)
    return bool(coded and np.diff(middle).max() > GAP * spread)


def _median(values: Array, counted: Mask) -> Array:
    """The lower median of the counted values (n, k) of each column, (k,); 0 if none is counted."""
    return _lower(values, counted, 0.5)


def _lower(values: Array, counted: Mask, share: float) -> Array:
    """The lower quantile of the counted values (n, k) of each column, (k,); 0 if none is."""
    if counted.all():
        place = int((len(values) - 1) * share)
        return np.partition(values, place, axis=0)[place]
    count = counted.sum(axis=0)
    in_order = np.sort(np.where(counted, values, np.inf), axis=0)
    places = (np.maximum(count - 1, 0) * share).astype(int)
    return np.where(count > 0, in_order[places, np.arange(len(count))], 0.0)


def _knots(values: Tensor) -> Tensor:
    """At most 4,096 values of each column of (n, r), sorted and evenly spaced in rank, (r, m)."""
    places = torch.linspace(0, len(values) - 1, min(len(values), KNOTS)).round().long()
    return values.T.sort(dim=1).values[:, places].contiguous()


def _near(z: Array) -> Array:
    """The same, with far values drawn near."""
    far = np.abs(z) > FAR
    return np.where(far, _drawn(z), z) if far.any() else z


def _drawn(z: Array) -> Array:
    """What values far from 0 are drawn to."""
    return np.sign(z) * (FAR + np.log(np.maximum(np.abs(z), FAR) / FAR))


@functools.lru_cache(maxsize=16)
def _pairs(rows: int) -> NDArray[np.int64]:
    """Random pairs of different rows, (2, 1024)."""
    rng = np.random.default_rng(0)
    first = rng.integers(rows, size=PAIRS)
    return np.stack([first, (first + rng.integers(1, max(2, rows), size=PAIRS)) % rows])
