"""Prior skew: does the noise of training depend on the condition?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from sklearn.neighbors import NearestNeighbors
from torch import Tensor

from cotlearn.couplings.base import to_numpy
from cotlearn.validation import check_condition, check_count, check_matrix, check_same_rows

MINIMUM_ROWS = 100


@dataclass(frozen=True)
class PriorSkew:
    """Is the noise of training independent of the condition?

    Attributes:
        statistic: excess share of neighbours of one's own kind, in [-1, 1]; about 0 if x0 and c
            are independent, towards 1 the more they depend on each other.
        p_value: share of relabelled statistics that are at least as large.
        flagged: p_value is at most the significance level: x0 depends on c.
    """

    statistic: float
    p_value: float
    flagged: bool


def prior_skew(
    x0: Tensor,
    c: Tensor,
    *,
    neighbours: int = 5,
    relabellings: int = 500,
    significance: float = 0.01,
    max_rows: int = 4000,
    generator: torch.Generator | None = None,
) -> PriorSkew:
    """Test whether p(x0 | c) is the prior, by nearest neighbours (Schilling 1986, two samples).

    Half of the pairs (x0, c) stay as they are, the other half get each other's conditions. If x0
    does not depend on c, nobody can tell the halves apart; if it does, pairs lie among pairs and
    shuffled pairs among shuffled ones. Because only near neighbours count, dependence in any
    moment is seen: also where E[x0 | c] is zero for every c, as naive OT leaves it on
    `moving_modes`. Noise and condition weigh the same, each scaled to unit variance.

    Args:
        x0: (n, d) noise as it was paired; n at least 100. Take several batches.
        c: (n, k) the condition that the network is given with it.
        neighbours: nearest neighbours that are looked at.
        relabellings: random relabellings behind the p-value.
        significance: level of the flag. An independent coupling is flagged this often.
        max_rows: rows used; more are subsampled.
        generator: randomness of the halves and the relabellings.

    Raises:
        ValueError: fewer than 100 rows, shapes that do not match, values that are not finite, or
            too few relabellings for the significance level.
    """
    check_matrix(x0, "x0")
    c = check_condition(c)
    check_same_rows(c, "c", x0, "x0")
    if len(x0) < MINIMUM_ROWS:
        raise ValueError(f"x0 and c need at least {MINIMUM_ROWS} rows, got {len(x0)}")
    check_count(max_rows, "max_rows", minimum=MINIMUM_ROWS)
    check_count(relabellings, "relabellings")
    if not 0 < significance < 1:
        raise ValueError(f"significance must lie between 0 and 1, got {significance}")
    if 1 / (1 + relabellings) > significance:
        needed = math.ceil(1 / significance - 1e-9) - 1
        raise ValueError(
            f"relabellings must be at least {needed}, or no p-value can reach significance "
            f"{significance:g}; got {relabellings}"
        )
    seed = int(torch.randint(2**62, (1,), generator=generator))
    rng = np.random.default_rng(seed)

    rows = rng.permutation(len(x0))[:max_rows]
    half = len(rows) // 2
    check_count(neighbours, "neighbours")
    if neighbours >= half:
        raise ValueError(f"neighbours must be below half the rows, {half}; got {neighbours}")
    noise, condition = unit_variance(to_numpy(x0)[rows]), unit_variance(to_numpy(c)[rows])
    condition[half:] = rng.permutation(condition[half:])
    shuffled = np.arange(len(rows)) >= half
    nearest = NearestNeighbors(n_neighbors=neighbours).fit(np.hstack([noise, condition]))
    near = nearest.kneighbors(return_distance=False)

    def excess(label: NDArray[np.bool_]) -> float:
        return float(2 * (label[near] == label[:, None]).mean() - 1)

    statistic = excess(shuffled)
    relabelled = np.array([excess(rng.permutation(shuffled)) for _ in range(relabellings)])
    p_value = float((1 + (relabelled >= statistic).sum()) / (1 + relabellings))
    return PriorSkew(statistic, p_value, p_value <= significance)


def unit_variance(
    values: NDArray[np.float64], reference: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Columns scaled so that the squared distances of the reference's rows are 2 on average."""
    reference = values if reference is None else reference
    std = reference.std(axis=0)
    varying = std > 1e-12 * np.abs(reference).max(axis=0)  # the rest is the mean's rounding
    if not varying.any():
        return np.zeros_like(values)
    scaled: NDArray[np.float64] = values[:, varying] / std[varying] / np.sqrt(varying.sum())
    return scaled
