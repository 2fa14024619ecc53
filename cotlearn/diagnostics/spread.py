"""Splits the variance of the data into a part between conditions and a part within them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.base import Array
from cotlearn.couplings.distances import to_numpy
from cotlearn.diagnostics.groups import numbered
from cotlearn.diagnostics.regression import regression
from cotlearn.diagnostics.skew import MOST_ROWS, check_conditioned, nearest
from cotlearn.validation import check_seed

FEWEST = 40  #: rows, so that a quarter of them can be predicted
FOLDS = 4  #: each row is predicted from the three quarters that it is not in


@dataclass(frozen=True)
class BetweenWithin:
    """The law of total variance for the trace of Var(x1), as far as a regression sees it.

    Attributes:
        total: tr Var(x1).
        within: an upper bound on E tr Var(x1 | c), the part that a coupling can straighten.
        between: a lower bound on tr Var(E[x1 | c]), the part with which naive OT is sure to skew
            the prior. A small value is no guarantee: `moving_modes` has almost none, and naive OT
            still fails there.
        curve: ((rows, share), ...), the share between with a quarter, a half and all of the rows
            (but for those that fewer than four groups have). Where it still rises, the true share
            is larger.
    """

    total: float
    within: float
    between: float
    curve: tuple[tuple[int, float], ...]

    @property
    def between_share(self) -> float:
        """between / total, in [0, 1]: a lower bound; 0 if the data do not vary."""
        return self.curve[-1][1]


def between_within(x1: Tensor, c: Tensor, *, groups: Any = None, seed: int = 0) -> BetweenWithin:
    """Split the variance of x1 (n, d) by the condition c (n, k).

    A regression predicts each row from other groups (cross-fitting in four parts). The share of the
    variance that it explains is a lower bound on the share between conditions, up to chance: no
    predictor errs less on fresh rows than E[x1 | c]. The bound rises with the number of rows as the
    regression learns, so look at `curve` before you compare data with other numbers of rows or of
    columns. What a regression cannot learn from so many rows counts as within.

    Args:
        x1: data, at least 40 rows; of more than 4,000 rows, 4,000 are drawn.
        c: conditions.
        groups: (n,), rows with the same value are never predicted from one another; if None, each
            row is a group. Rows of one episode repeat one another, and what a regression learns of
            the episode is not what the condition tells: give their episode.
        seed: of the subsample, the parts and the regression.

    Raises:
        ValueError: too few rows, fewer than four groups, shapes that do not match, or values that
            are not finite.
    """
    c = check_conditioned(x1, "x1", c)
    rng = np.random.default_rng(seed := check_seed(seed))
    if len(x1) < FEWEST:
        raise ValueError(f"x1 needs at least {FEWEST} rows, got {len(x1)}")
    group = numbered(groups, len(x1))
    rank = np.argsort(rng.permutation(int(group.max()) + 1))  # groups come one after the other
    rows = np.argsort(rank[group], kind="stable")[:MOST_ROWS]
    x, given, part = to_numpy(x1)[rows], to_numpy(c)[rows], rank[group][rows]
    curve = tuple(
        (n, explained(x[:n], given[:n], part[:n] % FOLDS, seed=seed))
        for n in (len(rows) // 4, len(rows) // 2, len(rows))
        if part[n - 1] >= FOLDS - 1
    )
    if not curve:
        raise ValueError(f"groups has {part[-1] + 1} different values: at least {FOLDS} are needed")
    total = float(x.var(axis=0).sum())
    between = total * curve[-1][1]
    return BetweenWithin(total, total - between, between, curve)


def explained(x1: Array, c: Array, parts: NDArray[np.intp], *, seed: int = 0) -> float:
    """The share of the variance of x1 (n, d) that a regression on c (n, k) explains, in [0, 1].

    Each row is predicted from the parts (n,), 0 to 3, that it is not in.
    """
    left = total = 0.0
    for part in range(FOLDS):
        new, old = parts == part, parts != part
        predicted = regression(x1[old], c[old], seed=seed)(c[new])
        left += float(np.square(x1[new] - predicted).sum())
        total += float(np.square(x1[new] - x1[old].mean(axis=0)).sum())
    return max(0.0, 1 - left / total) if total else 0.0


def local_variance(places: Array, values: Array, neighbours: int) -> Array:
    """tr Var of the values (n, d) over each row and its nearest places (n, m), for each row."""
    index = nearest(places, neighbours + 1, of=places)
    return values[index].var(axis=1, ddof=1).sum(axis=1)
