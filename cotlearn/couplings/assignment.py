"""The solvers behind the couplings: exact permutations, entropic plans, and drawing from a plan.

How the exact solver was chosen. Three solvers give the same optimum; which one is fastest depends
on the size of the batch and the dimension of the points. Milliseconds for one assignment, cost
|x0 - x1|^2 from noise to four clusters, one thread of a server CPU, best of three:

    batch, dimension     SciPy   lapx `lapjvs`   POT `emd`
      64,  2              0.21        0.17          0.22
     128,  2              1.39        1.96          0.84
     256,  2              8.27        13.7          2.94
     256, 16              3.40        1.86          3.79
    1024,  2              334         759           70
    1024, 16               86         46            104
    1024, 64               52         44            108

Points in a few dimensions make hard assignments (many nearly equal augmenting paths), on which
the network simplex of POT is best; in more dimensions Jonker-Volgenant wins. Hence the rule of
`exact_permutation`. `benchmarks/assignment.py` measures it again.
"""

from __future__ import annotations

import numpy as np
import ot
from lap import lapjvs
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cotlearn.validation import check_number

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FEW_DIMENSIONS = 3  #: up to here the network simplex is the fastest ...
LARGE_BATCH = 100  #: ... from this many rows on


def exact_permutation(cost: Array, *, dim: int | None = None) -> Index:
    """The permutation p that minimises sum_i cost[i, p[i]].

    Args:
        cost: (B, B), finite.
        dim: dimension of the points behind the cost, where it is known; only the choice of the
            solver (and so the time) depends on it.

    Returns:
        (B,), the column of each row.

    Raises:
        ValueError: the cost is not square, is empty, or is not finite.
    """
    cost = _check_cost(cost)
    if dim is not None and dim <= FEW_DIMENSIONS and len(cost) >= LARGE_BATCH:
        weights = np.full(len(cost), 1 / len(cost))
        plan = ot.emd(weights, weights, cost, numItermax=10_000_000)
        columns = plan.argmax(axis=1)
    else:
        columns = lapjvs(cost, return_cost=False)[1]
    columns = np.asarray(columns, dtype=np.int64)
    if len(np.unique(columns)) < len(cost):  # a solver gave up: the slowest never does
        columns = linear_sum_assignment(cost)[1].astype(np.int64)
    return columns


def sinkhorn_plan(cost: Array, *, regularization: float) -> Array:
    """The entropic plan between uniform weights (Cuturi 1306.0895), computed in the log domain.

    Args:
        cost: (B, B), finite.
        regularization: above 0, in units of the mean cost, so that it does not depend on the
            scale of the data.

    Returns:
        (B, B), non-negative; rows and columns sum to 1/B up to the solver's tolerance.
    """
    cost = _check_cost(cost)
    if check_number(regularization, "regularization") == 0:
        raise ValueError("regularization must be above 0; for 0 use the exact permutation")
    weights = np.full(len(cost), 1 / len(cost))
    scale = max(float(cost.mean()), np.finfo(float).tiny)
    plan: Array = ot.sinkhorn(
        weights, weights, cost / scale, regularization, method="sinkhorn_log", numItermax=1000,
        stopThr=1e-6, warn=False,
    )  # fmt: skip
    return plan


def draw_pairs(plan: Array, n: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Draw n pairs (row, column) from a plan, with replacement."""
    flat = plan.ravel().clip(min=0)
    drawn = rng.choice(flat.size, size=n, p=flat / flat.sum())
    rows, columns = np.divmod(drawn, plan.shape[1])
    return rows, columns


def _check_cost(cost: Array) -> Array:
    cost = np.ascontiguousarray(cost, dtype=np.float64)
    if cost.ndim != 2 or cost.shape[0] != cost.shape[1] or cost.size == 0:
        raise ValueError(f"cost must be a non-empty square matrix, got shape {cost.shape}")
    if not np.isfinite(cost).all():
        raise ValueError("cost has NaN or infinite values")
    return cost
