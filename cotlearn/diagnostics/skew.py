"""Skew: does the noise of training depend on the condition? Two tests."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.base import to_numpy
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.datasets import Standardiser
from cotlearn.validation import check_condition, check_count, check_matrix, check_same_rows

MINIMUM_ROWS, MOST_ROWS = 100, 4000  #: of a test; more rows are subsampled
NEIGHBOURS = 5
RELABELLINGS = 500  #: behind a p-value
SIGNIFICANCE = 0.01  #: level of a flag
ROWS_FOR_EACH = 5  #: rows for each feature of c, below which the chi-squared law is poor


@dataclass(frozen=True)
class PriorSkew:
    """Is the noise of training independent of the condition?

    Attributes:
        statistic: excess share of neighbours of one's own kind, in [-1, 1]; about 0 if x0 and c
            are independent, towards 1 the more they depend on each other.
        p_value: share of relabelled statistics that are at least as large.
        flagged: p_value is at most .01: x0 depends on c.
    """

    statistic: float
    p_value: float
    flagged: bool


def prior_skew(x0: Tensor, c: Tensor, *, generator: torch.Generator | None = None) -> PriorSkew:
    """Test whether p(x0 | c) is the prior, by nearest neighbours (Schilling 1986, two samples).

    Half of the pairs (x0, c) stay as they are, the other half get each other's conditions. If x0
    does not depend on c, nobody can tell the halves apart; if it does, pairs lie among pairs and
    shuffled pairs among shuffled ones. Because only near neighbours count, dependence in any
    moment is seen: also where E[x0 | c] is zero for every c, as naive OT leaves it on
    `moving_modes`. Noise and condition weigh the same, each scaled to unit variance. An independent
    coupling is flagged in one of a hundred tests.

    Args:
        x0: (n, d) noise as it was paired; n at least 100. Take several batches; of more than 4,000
            rows so many are drawn.
        c: (n, k) the condition that the network is given with it.
        generator: randomness of the halves and of 500 relabellings.

    Raises:
        ValueError: fewer than 100 rows, shapes that do not match, or values that are not finite.
    """
    c = check_conditioned(x0, "x0", c)
    if len(x0) < MINIMUM_ROWS:
        raise ValueError(f"x0 and c need at least {MINIMUM_ROWS} rows, got {len(x0)}")
    rng = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
    rows = rng.permutation(len(x0))[:MOST_ROWS]
    half = len(rows) // 2
    noise, condition = unit_variance(to_numpy(x0)[rows]), unit_variance(to_numpy(c)[rows])
    condition[half:] = rng.permutation(condition[half:])
    shuffled = np.arange(len(rows)) >= half
    from sklearn.neighbors import NearestNeighbors  # late: it takes a second

    nearest = NearestNeighbors(n_neighbors=NEIGHBOURS).fit(np.hstack([noise, condition]))
    near = nearest.kneighbors(return_distance=False)

    def excess(label: NDArray[np.bool_]) -> float:
        return float(2 * (label[near] == label[:, None]).mean() - 1)

    statistic = excess(shuffled)
    relabelled = np.array([excess(rng.permutation(shuffled)) for _ in range(RELABELLINGS)])
    p_value = float((1 + (relabelled >= statistic).sum()) / (1 + RELABELLINGS))
    return PriorSkew(statistic, p_value, p_value <= SIGNIFICANCE)


def check_conditioned(x: Tensor, name: str, c: Tensor) -> Tensor:
    """The conditions c as numbers (n, k), if x (n, d) and c are finite and have the same rows."""
    check_matrix(x, name)
    c = check_condition(c)
    check_same_rows(c, "c", x, name)
    return c


def unit_variance(
    values: NDArray[np.float64], reference: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Columns scaled so that the squared distances of the reference's rows are 2 on average."""
    scaler = Standardiser.fit(values if reference is None else reference)
    scaled: NDArray[np.float64] = scaler(values) / np.sqrt(max(1, (scaler.std > 0).sum()))
    return scaled


@dataclass(frozen=True)
class LinearSkew:
    """How much of the noise of training is a linear function of the condition's features?

    Attributes:
        explained: share of the noise's variance, adjusted for chance: about 0 if x0 and c are
            independent (a little below as often as above), 1 if the features fix x0.
        p_value: of no such dependence.
        flagged: p_value is at most .01.
    """

    explained: float
    p_value: float
    flagged: bool


def linear_skew(x0: Tensor, c: Tensor, *, degree: int = 1, cells: int | None = None) -> LinearSkew:
    """Test whether the mean of x0 given c is that of the prior, by canonical correlations.

    Pillai's trace V, the sum of the squared canonical correlations of x0 and the features of c,
    is divided by the d columns of x0: the share of the (whitened) noise's variance that a
    regression on c explains. Without dependence (n - 1) V has about the chi-squared law with d
    times p degrees of freedom, p features (Pillai 1955). An independent coupling is flagged in one
    of a hundred tests.

    `prior_skew` sees dependence of any kind, but by near neighbours, of which there are none
    in dozens of dimensions. This sees only the mean of x0, and sees it there: each row helps to
    estimate one regression. Where E[x0 | c] does not depend on c, as naive OT leaves it on
    `moving_modes`, it is blind. Ask both.

    A polynomial sees no more of E[x0 | c] than polynomials: of pairs that `centred` has made
    with a polynomial for its mean it finds next to nothing, because that is what was subtracted.
    There ask for `cells`, which make no assumption about the form.

    Args:
        x0: (n, d) noise as it was paired; n at least 5 times the features. Take tens of thousands.
        c: (n, k) the condition that the network is given with it.
        degree: 1 for the k columns of c as features, 2 for their squares and products as well.
        cells: instead of them, in which of so many k-means cells of c a row lies, at least 2: then
            it is the share of the noise's variance between cells. 64 are enough to begin with.

    Raises:
        ValueError: too few rows, shapes that do not match, or values that are not finite.
    """
    c = check_conditioned(x0, "x0", c)
    if degree not in (1, 2):
        raise ValueError(f"degree must be 1 or 2, got {degree!r}")
    if cells is None:
        from sklearn.preprocessing import PolynomialFeatures  # late: it takes a second

        polynomials = PolynomialFeatures(degree, include_bias=False)
        features = polynomials.fit_transform(_standardised(to_numpy(c)))
    else:  # 1 for the cell of c in which a row lies
        check_count(cells, "cells", minimum=2)
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
    """Whether `linear_skew` of degree 1 takes so few rows, x0 (n, d) and c (n, k)."""
    return len(x0) >= ROWS_FOR_EACH * max(x0.shape[1], c.shape[1])


def _whitened(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Orthonormal columns that span the centred ones; constant and repeated columns drop out."""
    left, size, _ = np.linalg.svd(_standardised(values), full_matrices=False)
    return left[:, size > 1e-6 * size.max(initial=0)]


def _standardised(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return Standardiser.fit(values)(values)
