"""Prior skew: two tests of whether training noise depends on the condition."""

import warnings
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.base import Array
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.couplings.distances import to_numpy
from cotlearn.couplings.units import TamedStandardiser, tamed
from cotlearn.datasets import Standardiser

MINIMUM_ROWS, MOST_ROWS = 100, 4000  #: of a test; more rows are subsampled
NEIGHBOURS = 5
RELABELLINGS = 500  #: random relabellings for a p-value
SIGNIFICANCE = 0.01  #: largest p-value that is flagged
MOST_REPEATED = 0.02  #: share of noise rows that occur again, without a warning
ROWS_FOR_EACH = 5  #: least rows per column of x0 and per feature, for the chi-squared law


@dataclass(frozen=True)
class PriorSkew:
    """Result of `prior_skew`, a test of whether training noise is independent of the condition.

    Attributes:
        statistic: excess share of neighbours of the same kind, in [-1, 1]; about 0 if x0 and c are
            independent, and the larger the more they depend on each other.
        p_value: share of relabelled statistics that are at least as large.
        flagged: whether p_value is at most .01, so that x0 depends on c.
    """

    statistic: float
    p_value: float
    flagged: bool


def prior_skew(x0: Tensor, c: Tensor, *, generator: torch.Generator | None = None) -> PriorSkew:
    """Test whether p(x0 | c) is the prior, by nearest neighbours (Schilling 1986, two samples).

    Half of the pairs (x0, c) are kept; in the other half the conditions are shuffled. If x0 does
    not depend on c, the halves cannot be told apart; if it does, the neighbours of a kept pair tend
    to be kept pairs, and those of a shuffled pair shuffled pairs. The test detects dependence in
    any moment, even if E[x0 | c] is zero for every c, as with naive OT on `moving_modes`. Noise and
    condition are scaled to unit variance and count equally. An independent coupling is flagged in
    one of a hundred tests.

    Near neighbours need few columns, of c as well as of x0. With two columns of x0, a fifth of
    whose variance is linear in c, 500 rows are flagged in half of all tests if c has two columns
    and in a fifth if it has twelve; 2,000 rows in all and in two thirds. `linear_skew` flags all of
    them. So with more than four columns of c use both, or group c first, for instance by
    `KMeansCondition`, and take several thousand rows.

    Args:
        x0: (n, d) paired noise, n at least 100, best from several batches. Of more than 4,000 rows,
            4,000 are drawn.
        c: (n, k) the condition that the network is given with x0.
        generator: randomness of the halves and of 500 relabellings.

    Raises:
        ValueError: fewer than 100 rows, shapes that do not match, or values that are not finite.
    """
    c = check_conditioned(x0, "x0", c)
    if len(x0) < MINIMUM_ROWS:
        raise ValueError(f"x0 and c need at least {MINIMUM_ROWS} rows, got {len(x0)}")
    validation.check_generator(generator)
    rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
    rows = rng.permutation(len(x0))[:MOST_ROWS]
    half = len(rows) // 2
    warn_of_repeated(to_numpy(x0)[rows])
    noise, condition = unit_variance(to_numpy(x0)[rows]), unit_variance(to_numpy(c)[rows])
    condition[half:] = rng.permutation(condition[half:])
    shuffled = np.arange(len(rows)) >= half
    near = nearest(np.hstack([noise, condition]), NEIGHBOURS)

    def excess(label: NDArray[np.bool_]) -> float:
        return float(2 * (label[near] == label[:, None]).mean() - 1)

    statistic = excess(shuffled)
    relabelled = np.array([excess(rng.permutation(shuffled)) for _ in range(RELABELLINGS)])
    p_value = float((1 + (relabelled >= statistic).sum()) / (1 + RELABELLINGS))
    return PriorSkew(statistic, p_value, p_value <= SIGNIFICANCE)


def check_conditioned(x: Tensor, name: str, c: Tensor) -> Tensor:
    """Return c (n, k) as floats if x (n, d) and c are finite and have equally many rows."""
    validation.check_matrix(x, name)
    c = validation.check_condition(c)
    validation.check_same_rows(c, "c", x, name)
    validation.check_squares(**{name: x, "c": c})
    return c


def warn_of_repeated(x0: Array) -> None:
    """Warn if rows of the noise x0 (n, d) occur several times, which no test of skew expects."""
    places = x0 @ np.random.default_rng(0).standard_normal(x0.shape[1])
    different = len(np.unique(places))
    if np.ptp(x0, axis=0).any() and different < (1 - MOST_REPEATED) * len(x0):
        warnings.warn(
            f"x0 has only {different} different rows of {len(x0)}: this test expects each noise "
            "row once, and flags repeated ones that are not skewed; draw pairs by permutation",
            RuntimeWarning,
            stacklevel=3,
        )


def unit_variance(values: Array, reference: Array | None = None) -> Array:
    """Scale the columns so that the reference's rows have a mean squared distance of 2."""
    units = TamedStandardiser.fit(values if reference is None else reference)
    return units(values) / np.sqrt(max(1, int((units.scaler.std > 0).sum())))


def nearest(places: Array, neighbours: int, *, of: Array | None = None) -> NDArray[np.int64]:
    """The rows of the places (n, m) nearest to each row `of` (k, m), or to each other if None."""
    from sklearn.neighbors import NearestNeighbors  # late: it takes a second

    near = NearestNeighbors(n_neighbors=neighbours).fit(places)
    return near.kneighbors(of, return_distance=False)


@dataclass(frozen=True)
class LinearSkew:
    """Result of `linear_skew`: the share of training noise that is linear in features of c.

    Attributes:
        explained: share of the noise's variance, adjusted for chance: about 0 if x0 and c are
            independent (negative as often as positive), 1 if the features determine x0.
        p_value: of the hypothesis that x0 does not depend linearly on the features.
        flagged: whether p_value is at most .01.
    """

    explained: float
    p_value: float
    flagged: bool


def linear_skew(x0: Tensor, c: Tensor, *, degree: int = 1, cells: int | None = None) -> LinearSkew:
    """Test whether the mean of x0 given c is that of the prior, by canonical correlations.

    Pillai's trace V is the sum of the squared canonical correlations of x0 and p features of c.
    V / d is the share of the (whitened) noise's variance that a regression on the features
    explains. Without dependence, (n - 1) V is approximately chi-squared with d p degrees of
    freedom (Pillai 1955). An independent coupling is flagged in one of a hundred tests; with noise
    of heavy tails, labels of a few rows, or rows that occur twice, more often.

    `prior_skew` detects dependence of any kind, but needs near neighbours, which do not exist in
    dozens of dimensions of x0 and c together. `linear_skew` detects only a dependent mean, but also
    in dozens of dimensions, because every row contributes to one regression. It detects nothing if
    E[x0 | c] does not depend on c, as with naive OT on `moving_modes`. Up to four columns start
    with `prior_skew`, beyond them with `linear_skew`; best use both.

    Polynomial features detect only polynomial means: if `centred` subtracted a polynomial, they
    find next to nothing in its pairs. Use `cells` there, which assume no form.

    Args:
        x0: (n, d) paired noise; n at least 5 times d and 5 times p, best tens of thousands.
        c: (n, k) the condition that the network is given with x0.
        degree: 1 takes the k columns of c as features, 2 their squares and products as well. Values
            far from all others, as -9999 for a missing one, are drawn near first.
        cells: if given, at least 2: the features are instead the k-means cell of c (one-hot), so
            that V / d is the share of the noise's variance between cells. Start with 64.

    Returns:
        The explained share, its p-value and whether it is significant.

    Raises:
        ValueError: too few rows, degree is not 1 or 2, shapes that do not match, or values that are
            not finite.
    """
    c = check_conditioned(x0, "x0", c)
    validation.check_count(degree, "degree", most=2)
    if cells is None:
        from sklearn.preprocessing import PolynomialFeatures  # late: it takes a second

        polynomials = PolynomialFeatures(degree, include_bias=False)
        features = polynomials.fit_transform(_standardised(to_numpy(tamed(c))))
    else:  # one-hot: the cell of each row
        validation.check_count(cells, "cells", minimum=2)
        features = np.eye(cells)[KMeansCondition(min(cells, len(c))).fit(c).labels(c)]
    noise, features = _whitened(to_numpy(x0)), _whitened(features)
    n, d, p = len(noise), noise.shape[1], features.shape[1]
    if n < ROWS_FOR_EACH * max(d, p):
        raise ValueError(
            f"x0 and c need at least {ROWS_FOR_EACH * max(d, p)} rows for {d} columns of noise "
            f"and {p} features, got {n}"
        )
    if not d or not p:
        return LinearSkew(0.0, 1.0, False)
    share = float(np.square(noise.T @ features).sum()) / d
    from scipy import stats  # late: it takes a second

    p_value = float(stats.chi2.sf((n - 1) * d * share, d * p))
    explained = 1 - (1 - share) * (n - 1) / (n - p - 1)
    return LinearSkew(explained, p_value, p_value <= SIGNIFICANCE)


def enough_rows(x0: Tensor, c: Tensor) -> bool:
    """Whether x0 (n, d) and c (n, k) have enough rows for `linear_skew` of degree 1."""
    return len(x0) >= ROWS_FOR_EACH * max(x0.shape[1], c.shape[1])


def _whitened(values: Array) -> Array:
    """Orthonormal columns with the span of the centred columns; dependent columns are dropped."""
    left, size, _ = np.linalg.svd(_standardised(values), full_matrices=False)
    return left[:, size > 1e-6 * size.max(initial=0)]


def _standardised(values: Array) -> Array:
    return Standardiser.fit(values)(values)
