"""The solvers behind the couplings: exact permutations, entropic plans, and drawing from a plan.

How the exact solver was chosen. Four ways give the same optimum; which is fastest depends on the
size of the batch and the dimension of the points. Milliseconds for one assignment, cost
|x0 - x1|^2 from noise to a broad Gaussian / to eight clusters, float64, one thread of a busy
server CPU, median of five (compare within a row; `benchmarks/assignment.py` measures again):

    batch, dimension     SciPy        lapx lapjvs    POT emd       POT emd, warm
      64,  2            .24 / .26     .35 / .29      .26 / .26     .36 / .41
     128,  2            1.6 / 1.2     2.5 / 1.8      1.1 / .75     1.2 / 1.0
     128, 16            .83 / 1.2     .41 / 1.2      .93 / .85     .86 / .94
     256,  2            9.6 / 10      17  / 20       3.9 / 4.1     4.1 / 4.8
     256, 64            4.0 / 6.7     2.8 / 12       4.2 / 4.2     3.6 / 3.6
    1024,  2            424 / 424     981 / 1071     103 / 96      102 / 94
    1024, 64            123 / 441     162 / 186      135 / 190     99  / 93

Points in a few dimensions make hard assignments (many nearly equal augmenting paths), on which
POT's network simplex is best from 100 rows on; small batches go to SciPy, or in more dimensions
to Jonker-Volgenant (lapx); large batches in many dimensions gain from starting the simplex at the
potentials of a few Sinkhorn steps ("warm"), which changes the time and not the optimum.
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

FEW_DIMENSIONS = 3  #: up to here assignments are hard, and the network simplex is fastest ...
LARGE_BATCH = 100  #: ... from this many rows on ...
LARGE_BATCH_MANY_DIMENSIONS = 200  #: ... and in more dimensions from this many, warm
UNDERFLOW = 100.0  #: exp(-100) is a number, exp(-1000) is not: beyond this, logarithms


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
    cost = _enlarged(cost - cost.min())  # POT takes a warm start amiss where costs are negative
    if dim is not None and dim <= FEW_DIMENSIONS:
        columns = _simplex(cost) if len(cost) >= LARGE_BATCH else linear_sum_assignment(cost)[1]
    elif len(cost) >= LARGE_BATCH_MANY_DIMENSIONS:
        columns = _simplex(cost, start=_sinkhorn_potentials(cost))
    else:
        columns = lapjvs(cost, return_cost=False, prefer_float32=False)[1]
    columns = np.asarray(columns, dtype=np.int64)
    if len(np.unique(columns)) < len(cost):  # a solver gave up: the slowest never does
        columns = linear_sum_assignment(cost)[1].astype(np.int64)
    return columns


def _simplex(cost: Array, start: tuple[Array, Array] | None = None) -> Index:
    weights = np.full(len(cost), 1 / len(cost))
    plan = ot.emd(weights, weights, cost, numItermax=10_000_000, potentials_init=start)
    columns: Index = plan.argmax(axis=1)
    return columns


def _sinkhorn_potentials(
    cost: Array, *, steps: int = 10, share: float = 0.05
) -> tuple[Array, Array]:
    """Rough dual potentials, by a few Sinkhorn steps in single precision."""
    epsilon = max(share * float(cost.std()), np.finfo(np.float32).tiny)
    kernel = np.exp(((cost.min() - cost) / epsilon).astype(np.float32))
    u, least = np.ones(len(cost), np.float32), np.float32(1e-20)
    v = u
    for _ in range(steps):
        v = 1 / (kernel.T @ u + least)
        u = 1 / (kernel @ v + least)
    return epsilon * np.log(u.astype(np.float64)), epsilon * np.log(v.astype(np.float64))


def sinkhorn_plan(cost: Array, *, regularization: float) -> Array:
    """The entropic plan between uniform weights (Cuturi 1306.0895).

    With logarithms where the plan's entries could underflow, else without, ten times faster.

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
    scaled = (cost - cost.min()) / scale  # a constant changes no plan
    method = "sinkhorn" if scaled.max() < UNDERFLOW * regularization else "sinkhorn_log"
    plan: Array = ot.sinkhorn(
        weights, weights, scaled, regularization, method=method, numItermax=1000, stopThr=1e-6,
        warn=False,
    )  # fmt: skip
    return plan


def draw_pairs(plan: Array, n: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Draw n pairs (row, column) from a plan, with replacement."""
    flat = plan.ravel().clip(min=0)
    drawn = rng.choice(flat.size, size=n, p=flat / flat.sum())
    rows, columns = np.divmod(drawn, plan.shape[1])
    return rows, columns


def _enlarged(cost: Array) -> Array:
    """The cost times a power of two, so that POT's absolute tolerance (1e-14) is far below it."""
    _, exponent = np.frexp(np.abs(cost).max())
    large: Array = np.ldexp(cost, 40 - exponent)
    return large


def _check_cost(cost: Array) -> Array:
    cost = np.ascontiguousarray(cost, dtype=np.float64)
    if cost.ndim != 2 or cost.shape[0] != cost.shape[1] or cost.size == 0:
        raise ValueError(f"cost must be a non-empty square matrix, got shape {cost.shape}")
    if not np.isfinite(cost).all():
        raise ValueError("cost has NaN or infinite values")
    return cost
