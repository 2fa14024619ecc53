"""Conditions in units of their own, so that no column decides alone because its numbers are large.

A distance of conditions adds the squares of all columns. A force in newtons or a time in seconds
then outweighs a label, and noise is skewed by the label without a word. So does a sentinel, as
-9999 for a missing value.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.compiled import at_rank, compiled
from cotlearn.couplings.distances import Array, Index, to_numpy
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
        values = to_numpy(c)
        centre, spread, several = _measures(values, c.dtype)
        ranked = torch.from_numpy(np.flatnonzero(several))
        knots = _knots(torch.from_numpy(values)[:, ranked]) if len(ranked) else torch.zeros(0, 0)
        return cls(torch.from_numpy(centre), torch.from_numpy(spread), ranked, knots)

    def __call__(self, c: Tensor) -> Tensor:
        """The columns in units of their own, (n, k), float64; constant columns become 0."""
        return self._with_ranks(c, torch.from_numpy(self._spreads_away(c)).to(c.device))

    def tamed(self, c: Tensor) -> Tensor:
        """C (n, k) with far values drawn near, and ranks for columns of several scales.

        The other columns keep their units; if there is nothing to do, c itself is returned.
        """
        c = check_condition(c)
        z = self._spreads_away(c)
        far = np.abs(z) > FAR
        if not (far.any() or len(self.ranked)):
            return c
        drawn = torch.from_numpy(self.centre.numpy() + self.spread.numpy() * z)
        near = torch.where(torch.from_numpy(far).to(c.device), drawn.to(c), c)
        return self._with_ranks(c, near)

    def _spreads_away(self, c: Tensor) -> Array:
        """The columns of c (n, k), in spreads from their median, with far values drawn near."""
        if c.shape[-1] != len(self.centre):
            raise ValueError(f"c has {c.shape[-1]} columns, expected {len(self.centre)}")
        return _all_near(to_numpy(c), self.centre.numpy(), self.spread.numpy())

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


def in_own_units(c: Tensor) -> Array:
    """`OwnUnits.fit(c)(c)` of a checked batch, as an array, with fewer calls."""
    values = to_numpy(c)
    centre, spread, several = _measures(values, c.dtype)
    if several.any():
        return to_numpy(OwnUnits.fit(c)(c))
    near: Array = _all_near(values, centre, spread)
    return near


def tamed(c: Tensor) -> Tensor:
    """C (n, k) with far values drawn near, and several scales ranked; see `OwnUnits.tamed`."""
    return OwnUnits.fit(c).tamed(c)


def _measures(values: Array, dtype: torch.dtype) -> tuple[Array, Array, Mask]:
    """Of each column of (n, k): centre, spread, and whether it has several scales."""
    first, second = _pairs(len(values))
    centre, spread, coded, several = _measured(values, first, second, torch.finfo(dtype).eps)
    for column in np.flatnonzero(coded):
        several[column] |= _holds_codes(values[first, column], spread[column], len(values))
    return centre, spread, several


def _holds_codes(values: Array, spread: float, rows: int) -> bool:
    """Whether values (n,), drawn from so many rows, are codes, or have one for what is missing."""
    few = int(RARE * len(values))
    middle = np.sort(values)[few : len(values) - few]
    _, count = np.unique(middle, return_counts=True)
    few_values = len(count) <= min(CODES, rows / 2)  # few rows have few in any case
    often = count.max() > max(OFTEN, 1.5 / rows) * len(values)  # one row alone is not
    coded = few_values or often
    return bool(coded and np.diff(middle).max() > GAP * spread)


def _knots(values: Tensor) -> Tensor:
    """At most 4,096 values of each column of (n, r), sorted and evenly spaced in rank, (r, m)."""
    places = np.linspace(0, len(values) - 1, min(len(values), KNOTS)).round().astype(np.int64)
    return values.T.sort(dim=1).values[:, torch.from_numpy(places)].contiguous()


@functools.lru_cache(maxsize=16)
def _pairs(rows: int) -> Index:
    """Random pairs of different rows, (2, 1024)."""
    rng = np.random.default_rng(0)
    first = rng.integers(rows, size=PAIRS)
    return np.stack([first, (first + rng.integers(1, max(2, rows), size=PAIRS)) % rows])


@compiled()
def _measured(
    values: Array, first: Index, second: Index, eps: float
) -> tuple[Array, Array, Mask, Mask]:
    """Of each column of (n, k): centre, spread, whether it may hold codes, or has several scales.

    Differences are those of the pairs of rows `first` and `second`. Compiled, because a batch is
    small, and each call of NumPy takes longer than its work.
    """
    rows, pairs, k = len(values), len(first), values.shape[1]
    centre, spread = np.zeros(k), np.zeros(k)
    coded, several = np.zeros(k, np.bool_), np.zeros(k, np.bool_)
    one, size, unequal = np.empty(pairs), np.empty(pairs), np.empty(pairs)
    for j in range(k):
        low, high, whole = values[0, j], values[0, j], True
        for i in range(rows):
            low, high = min(low, values[i, j]), max(high, values[i, j])
            whole &= values[i, j] == np.rint(values[i, j])
        reach, largest = high - low, max(abs(low), abs(high))
        rounding = eps * (ROUNDING_NEAR if reach <= NEAR * eps * largest else ROUNDING)
        if whole:  # whole numbers are exact
            rounding = 0.0
        positive = 0
        for i in range(pairs):
            one[i] = values[first[i], j]
            larger = max(abs(one[i]), abs(values[second[i], j]))
            if larger > 0:
                size[positive] = larger
                positive += 1
        usual, differ, logarithms, squares = _lower(size[:positive], 0.5), 0, 0.0, 0.0
        for i in range(pairs):
            a, b = values[first[i], j], values[second[i], j]
            if abs(a - b) > rounding * max(abs(a), abs(b), usual):
                unequal[differ] = abs(a - b)
                logarithms += math.log(unequal[differ])
                differ += 1
        centre[j] = _lower(one, 0.5)
        if differ:
            spread[j] = math.exp(logarithms / differ)
        elif reach > rounding * largest:  # no pair met the few unequal rows
            spread[j] = reach
        coded[j] = _lower(unequal[:differ], OFTEN) < SMALL * spread[j]
        for i in range(pairs):
            a, b = values[first[i], j], values[second[i], j]
            if abs(a - b) > rounding * max(abs(a), abs(b), usual):
                apart = _near(a, centre[j], spread[j]) - _near(b, centre[j], spread[j])
                squares += apart * apart
        several[j] = math.sqrt(squares / max(1, differ)) > SEVERAL
    return centre, spread, coded, several


@compiled()
def _lower(values: Array, share: float) -> float:
    """The lower quantile of (n,); 0 if there are no values."""
    return at_rank(values, int((len(values) - 1) * share)) if len(values) else 0.0


@compiled()
def _near(value: float, centre: float, spread: float) -> float:
    """A value in spreads from the centre, drawn near if it is far; 0 if there is no spread."""
    z = (value - centre) / spread if spread > 0 else 0.0
    return z if abs(z) <= FAR else math.copysign(FAR + math.log(abs(z) / FAR), z)


@compiled()
def _all_near(values: Array, centre: Array, spread: Array) -> Array:
    """Values (n, k) in spreads from the centres (k,), with far ones drawn near."""
    near = np.empty(values.shape)
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            near[i, j] = _near(values[i, j], centre[j], spread[j])
    return near
