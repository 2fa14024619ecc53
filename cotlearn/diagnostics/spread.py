"""Splits the variance of the data into a part between conditions and a part within them."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from cotlearn.couplings.base import Array, to_numpy
from cotlearn.diagnostics.skew import MOST_ROWS, check_conditioned, nearest, unit_variance
from cotlearn.validation import check_count

NEIGHBOURS = 10  #: rows with near conditions


@dataclass(frozen=True)
class BetweenWithin:
    """The law of total variance for the trace of Var(x1).

    Attributes:
        total: tr Var(x1).
        within: E tr Var(x1 | c), the part that a coupling can straighten.
        between: tr Var(E[x1 | c]), the part with which naive OT is sure to skew the prior. A small
            value is no guarantee: `moving_modes` has almost none, and naive OT still fails there.
        between_share: between / total, in [0, 1]; 0 if the data do not vary.
    """

    total: float
    within: float
    between: float

    @property
    def between_share(self) -> float:
        """between / total."""
        return self.between / self.total if self.total else 0.0


def between_within(x1: Tensor, c: Tensor, *, seed: int = 0) -> BetweenWithin:
    """Split the variance of x1 (n, d) by the condition c (n, k).

    Var(x1 | c) is estimated from each row and the 10 rows with the nearest conditions (columns
    scaled to unit variance). Ties are broken at random, so labels and numbers are treated alike.
    Where few rows have near conditions, part of the variance between conditions counts as within.

    Args:
        x1: data, at least 11 rows; of more than 4,000 rows, 4,000 are drawn.
        c: conditions.
        seed: of the subsample and the ties.

    Raises:
        ValueError: too few rows, shapes that do not match, or values that are not finite.
    """
    c = check_conditioned(x1, "x1", c)
    rng = np.random.default_rng(check_count(seed, "seed", minimum=0))
    rows = rng.permutation(len(x1))[:MOST_ROWS]
    if len(rows) <= NEIGHBOURS:
        raise ValueError(f"x1 needs more than {NEIGHBOURS} rows, got {len(rows)}")
    x = to_numpy(x1)[rows]
    total = float(x.var(axis=0).sum())
    ties = 1e-6 * rng.random((len(rows), 1))  # else all rows of a label have the same neighbours
    places = np.hstack([unit_variance(to_numpy(c)[rows]), ties])
    within = min(float(local_variance(places, x, NEIGHBOURS).mean()), total)
    return BetweenWithin(total, within, total - within)


def local_variance(places: Array, values: Array, neighbours: int) -> Array:
    """tr Var of the values (n, d) over each row and its nearest places (n, m), for each row."""
    index = nearest(places, neighbours + 1, of=places)
    return values[index].var(axis=1, ddof=1).sum(axis=1)
