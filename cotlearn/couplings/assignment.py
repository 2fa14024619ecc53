"""The solvers behind the couplings: exact permutations, entropic plans, and drawing from a plan.

How the exact solver works. SciPy's assignment (shortest augmenting paths) takes long because its
dual potentials start at zero. Potentials f, g may be taken off the cost before it begins,
c_ij - f_i - g_j has the same optimal permutation, and a few dozen Sinkhorn steps in single
precision give potentials that are nearly optimal: most rows then find a free column at once. The
potentials change the time and not the optimum, which SciPy finds in double precision.

The temperature falls from a tenth of the cost's standard deviation to 1/B of it, because the
distance to the nearest of B points falls likewise, in factors of about five with up to ten
over-relaxed steps each (Thibault 1711.01851); with larger relaxation (1.7) single problems were
slower by ten times, and colder ends or more steps gained nothing. `benchmarks/assignment.py`
measures it beside SciPy alone, POT's network simplex and torchcfm.
"""

from __future__ import annotations

import numpy as np
import ot
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cotlearn.validation import check_number

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Single = NDArray[np.float32]

SMALL_BATCH = 64  #: up to here SciPy is done before potentials would be
EASY = 0.75  #: share of rows with a cheapest column of their own, above which SciPy needs no help
RELAXATION = 1.4  #: of the Sinkhorn steps, in [1, 2)
LEAST = np.float32(1e-18)  #: scalings stay in [1e-18, 1e18], kernels below e^40: no overflow
LARGEST_EXPONENT = np.float32(40.0)
UNDERFLOW = 100.0  #: exp(-100) is a number, exp(-1000) is not: beyond this, logarithms


def exact_permutation(cost: Array) -> Index:
    """The permutation p that minimises sum_i cost[i, p[i]].

    Args:
        cost: (B, B), finite.

    Returns:
        (B,), the column of each row.

    Raises:
        ValueError: the cost is not square, is empty, or is not finite.
    """
    cost = _check_cost(cost)
    if len(cost) > SMALL_BATCH:
        reduced = cost - cost.min(axis=0)
        if len(np.unique(reduced.argmin(axis=1))) < EASY * len(cost):
            rows, columns = _potentials(reduced)
            reduced -= rows[:, None]
            reduced -= columns
        cost = reduced
    permutation: Index = linear_sum_assignment(cost)[1].astype(np.int64)
    return permutation


def _potentials(cost: Array) -> tuple[Array, Array]:
    """Nearly optimal dual potentials of an assignment, by Sinkhorn steps that grow colder."""
    size, scale = len(cost), float(cost.max())
    if scale == 0:
        return np.zeros(size), np.zeros(size)
    single = (cost / scale).astype(np.float32)
    spread = single.std()
    single /= spread
    scale *= float(spread)
    rows, columns = np.zeros((2, size), np.float32)
    kernel = np.empty_like(single)
    steps = min(10, 5 + size // 128)
    stages = max(2, 1 + round(np.log(0.1 * size) / np.log(5)))
    for epsilon in np.geomspace(0.1, 1 / size, stages).astype(np.float32):
        np.subtract(columns, single, out=kernel)
        kernel += rows[:, None]
        kernel /= epsilon
        np.exp(np.minimum(kernel, LARGEST_EXPONENT, out=kernel), out=kernel)
        u, v = np.ones((2, size), np.float32)
        for _ in range(steps):
            u = _relaxed(u, kernel @ v)
            v = _relaxed(v, u @ kernel)
        rows, columns = rows + epsilon * np.log(u), columns + epsilon * np.log(v)
    return scale * rows.astype(np.float64), scale * columns.astype(np.float64)


def _relaxed(scaling: Single, product: Single) -> Single:
    """The scaling after an over-relaxed step towards 1 / product, kept within its range."""
    towards = scaling * (scaling * product + LEAST) ** np.float32(-RELAXATION)
    return np.clip(towards, LEAST, 1 / LEAST)


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


def _check_cost(cost: Array) -> Array:
    cost = np.ascontiguousarray(cost, dtype=np.float64)
    if cost.ndim != 2 or cost.shape[0] != cost.shape[1] or cost.size == 0:
        raise ValueError(f"cost must be a non-empty square matrix, got shape {cost.shape}")
    if not np.isfinite(cost).all():
        raise ValueError("cost has NaN or infinite values")
    return cost
