"""Linear skew: the share of the noise that the condition foretells, in any number of dimensions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import stats
from torch import Tensor

from cotlearn.couplings.base import to_numpy
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.validation import check_condition, check_count, check_matrix, check_same_rows

_ROWS_FOR_EACH = 5  #: rows for each feature of the condition, below which the law is a poor guide


@dataclass(frozen=True)
class LinearSkew:
    """How much of the noise of training is a linear function of the condition's features?

    Attributes:
        explained: share of the noise's variance, adjusted for chance: about 0 if x0 and c are
            independent (a little below as often as above), 1 if the features fix x0.
        p_value: of no such dependence.
        flagged: p_value is at most the significance level.
    """

    explained: float
    p_value: float
    flagged: bool


def linear_skew(
    x0: Tensor,
    c: Tensor,
    *,
    degree: int = 1,
    cells: int | None = None,
    significance: float = 0.01,
) -> LinearSkew:
    """Test whether the mean of x0 given c is that of the prior, by canonical correlations.

    Pillai's trace V, the sum of the squared canonical correlations of x0 and the features of c,
    is divided by the d columns of x0: the share of the (whitened) noise's variance that a
    regression on c explains. Without dependence (n - 1) V has about the chi-squared law with d
    times p degrees of freedom, p features (Pillai 1955).

    `prior_skew` sees dependence of any kind, but by near neighbours, of which there are none
    in dozens of dimensions. This sees only the mean of x0, and sees it there: each row helps to
    estimate one regression. Where E[x0 | c] does not depend on c, as naive OT leaves it on
    `moving_modes`, it is blind. Ask both.

    And a polynomial sees no more of E[x0 | c] than polynomials: of pairs that `Centred` has made
    with a polynomial for its mean it finds next to nothing, because that is what was taken off.
    There ask for `cells`, which make no assumption about the form.

    Args:
        x0: (n, d) noise as it was paired; n at least 5 times the features. Take tens of thousands.
        c: (n, k) the condition that the network is given with it.
        degree: 1 for the k columns of c as features, 2 for their squares and products as well.
        cells: instead of them, in which of so many k-means cells of c a row lies, at least 2: then
            it is the share of the noise's variance between cells. 64 are enough to begin with.
        significance: level of the flag. An independent coupling is flagged this often.

    Raises:
        ValueError: too few rows, shapes that do not match, or values that are not finite.
    """
    check_matrix(x0, "x0")
    c = check_condition(c)
    check_same_rows(c, "c", x0, "x0")
    if degree not in (1, 2):
        raise ValueError(f"degree must be 1 or 2, got {degree!r}")
    if not 0 < significance < 1:
        raise ValueError(f"significance must lie between 0 and 1, got {significance}")
    if cells is None:
        features = _whitened(_features(to_numpy(c), degree))
    else:
        features = _whitened(_indicators(c, check_count(cells, "cells", minimum=2)))
    noise = _whitened(to_numpy(x0))
    n, d, p = len(noise), noise.shape[1], features.shape[1]
    if n < _ROWS_FOR_EACH * max(d, p):
        raise ValueError(
            f"x0 and c need at least {_ROWS_FOR_EACH * max(d, p)} rows for {d} columns of noise "
            f"and {p} features, got {n}"
        )
    if not d or not p:
        return LinearSkew(0.0, 1.0, False)
    share = float(np.square(noise.T @ features).sum()) / d
    p_value = float(stats.chi2.sf((n - 1) * d * share, d * p))
    explained = 1 - (1 - share) * (n - 1) / (n - p - 1)
    return LinearSkew(explained, p_value, p_value <= significance)


def enough_rows(x0: Tensor, c: Tensor) -> bool:
    """Whether `linear_skew` of degree 1 takes so few rows, x0 (n, d) and c (n, k)."""
    return len(x0) >= _ROWS_FOR_EACH * max(x0.shape[1], c.shape[1])


def _features(c: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    if degree == 1:
        return c
    scale = c.std(axis=0)
    c = (c - c.mean(axis=0)) / np.where(scale > 0, scale, 1)
    return np.hstack([c, *(c[:, i : i + 1] * c[:, i:] for i in range(c.shape[1]))])


def _indicators(c: Tensor, cells: int) -> NDArray[np.float64]:
    """(n, cells), 1 for the cell of c in which a row lies."""
    labels = KMeansCondition(min(cells, len(c))).fit(c).labels(c)
    return to_numpy(torch.nn.functional.one_hot(labels).double())


def _whitened(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Orthonormal columns that span the centred ones; constant and repeated columns drop out."""
    centred = values - values.mean(axis=0)
    scale = centred.std(axis=0)
    varies = scale > 1e-12 * np.abs(values).max(axis=0)
    left, size, _ = np.linalg.svd(centred[:, varies] / scale[varies], full_matrices=False)
    return left[:, size > 1e-6 * size.max(initial=0)]
