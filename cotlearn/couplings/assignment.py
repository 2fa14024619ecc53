"""The solvers behind the couplings: exact permutations, entropic plans, and drawing from a plan.

The exact solver has two stages. A few Sinkhorn steps in single precision (`annealing.py`) give
nearly optimal dual potentials, with which most rows find a free column at once; shortest augmenting
paths in double precision (`augmenting.py`) assign the remaining rows. The potentials change the
time, never the optimum: where rounding errors of the potentials are not small against the
differences of costs, or where the paths are long, SciPy solves. Lower last temperatures, more steps
and stronger over-relaxation did not pay over all sizes.

The temperature is a share of the costs' standard deviation. It is a share of (mean - least cost)
where that is far larger, as for the entries of a Sinkhorn plan, nearly all of which are 0. It falls
further where a row's lowest costs lie much closer together, as within clusters that lie far apart.
`benchmarks/assignment.py` compares the solver with torchcfm, SciPy and POT.
"""

import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from cotlearn.couplings.annealing import nearness, potentials, survey
from cotlearn.couplings.augmenting import assign
from cotlearn.couplings.compiled import compiled
from cotlearn.couplings.distances import EPS
from cotlearn.validation import check_number

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SMALL_BATCH = 32  #: rows up to which SciPy alone is faster
EASY = 0.75  #: share of rows with a cheapest column of their own, above which SciPy is as fast
SHARP = 1e-7  #: rounding errors of the costs, as a share of the lowest costs' distances
BLUNT = 1e-3  #: the same, above which no solver is exact
SINKHORN_STEPS, SINKHORN_ERROR = 1000, 1e-6  #: most steps; tolerance of the marginals
MARGINALS_OFF = 0.05  #: share by which a marginal of a plan may miss 1/B without a warning
UNDERFLOW = 100.0  #: exponent above which Sinkhorn needs logarithms: exp(-1000) is 0


def exact_permutation(cost: Array) -> Index:
    """The permutation p that minimises sum_i cost[i, p[i]].

    Args:
        cost: (B, B), finite.

    Returns:
        (B,), the column of each row.

    Raises:
        ValueError: the cost is not square, is empty, or is not finite.

    Warns (RuntimeWarning) if some costs are so large that rounding hides the others.
    """
    cost = _check_cost(cost)
    if len(cost) > SMALL_BATCH:
        least, spread, near, easy = survey(cost)
        if 1e-30 < spread < 1e30 and easy < EASY * len(cost):  # single precision holds the scale
            rows, columns = potentials(cost, least, spread, near)
            if _rounding(cost, rows, columns) < SHARP * near:
                found = assign(cost, rows, columns)
                if found is not None:
                    return found
    return _by_scipy(cost)


def _by_scipy(cost: Array) -> Index:
    """The same without potentials of our own, and with large costs brought down first."""
    if _rounding(cost) >= SHARP * min(nearness(cost), nearness(cost.T)):
        tied, cost = _has_copies(cost), _reduced(cost)
        near, rounding = nearness(cost), _rounding(cost)
        if rounding > BLUNT * near > 0 and not tied:
            warnings.warn(
                f"costs up to {cost.max():.3g} hide the others, whose lowest differ by "
                f"{near:.3g}: rounding chooses their pairs; leave out the rows that are so far off",
                RuntimeWarning,
                stacklevel=2,
            )
    return linear_sum_assignment(cost)[1].astype(np.int64)


def _has_copies(cost: Array) -> bool:
    """Whether most rows find their lowest costs equal but for rounding: data rows are repeated."""
    lowest = np.partition(cost, (0, len(cost) // 10), axis=1)
    low, next_ones = lowest[:, 0], lowest[:, len(cost) // 10]
    rounding = 16 * EPS * np.abs(next_ones)
    return bool((next_ones - low <= rounding).mean() >= 0.5)


def _reduced(cost: Array) -> Array:
    """The cost less a constant for each row and column, which changes no optimum.

    First come those, rows or columns, that differ more: the others' constants would else hold the
    noise of one of them, and SciPy's paths would be up to twenty times as long.
    """
    first = 1 if np.ptp(cost.min(axis=1)) > np.ptp(cost.min(axis=0)) else 0
    cost = cost - cost.min(axis=first, keepdims=True)
    cost -= cost.min(axis=1 - first, keepdims=True)
    return cost


def _rounding(*values: Array) -> float:
    """The rounding error of sums of these numbers."""
    return EPS * max(_largest(some.ravel()) for some in values)


@compiled(fastmath={"reassoc", "nsz"})
def _largest(values: Array) -> float:
    """The largest |x| of (n,); NaN if there is one, or an infinity."""
    largest, total = 0.0, 0.0
    for i in range(len(values)):
        largest = max(largest, abs(values[i]))
        total += 0.0 * values[i]
    return largest + total


def sinkhorn_plan(cost: Array, *, regularization: float) -> Array:
    """The entropic plan between uniform weights (Cuturi 1306.0895).

    It works on logarithms only where the plan's entries could underflow; otherwise it is ten times
    faster.

    Args:
        cost: (B, B), finite.
        regularization: above 0, in units of the mean cost, so that it does not depend on the
            scale of the data; of costs below 0, in units of the mean cost above the least.

    Returns:
        (B, B), non-negative; rows and columns sum to 1/B up to the solver's tolerance.

    Warns (RuntimeWarning) if a row or column is more than 5 % off, as with a small regularization.
    """
    cost = _check_cost(cost)
    if check_number(regularization, "regularization") == 0:
        raise ValueError("regularization must be above 0; for 0 use the exact permutation")
    scaled = cost - cost.min()  # a constant changes no plan
    scaled /= max(float((scaled if cost.min() < 0 else cost).mean()), np.finfo(float).tiny)
    if scaled.max() < UNDERFLOW * regularization:
        return _converged(_scaled_kernel(np.exp(-scaled / regularization)), regularization)
    import ot  # late: it takes two seconds

    weights = np.full(len(cost), 1 / len(cost))
    plan: Array = ot.sinkhorn(
        weights, weights, scaled, regularization, method="sinkhorn_log", numItermax=SINKHORN_STEPS,
        stopThr=SINKHORN_ERROR, warn=False,
    )  # fmt: skip
    return _converged(plan, regularization)


def _converged(plan: Array, regularization: float) -> Array:
    """The plan, with a warning if its marginals are far from uniform."""
    off = max(float(abs(plan.sum(axis=axis) * len(plan) - 1).max()) for axis in (0, 1))
    if not off <= MARGINALS_OFF:
        warnings.warn(
            f"the Sinkhorn plan has not converged: a marginal is {100 * off:.0f} % off; raise "
            f"regularization above {regularization:g}, or use the exact plan",
            RuntimeWarning,
            stacklevel=3,
        )
    return plan


def _scaled_kernel(kernel: Array) -> Array:
    """Scale rows and columns in turn until each sums to 1/B.

    These are the steps of `ot.sinkhorn` without its check for infinities after each step, which at
    64 rows takes longer than the step.
    """
    weight = 1 / len(kernel)
    u = np.full(len(kernel), weight)
    for step in range(SINKHORN_STEPS):
        v = weight / (u @ kernel)
        u = weight / (kernel @ v)
        if step % 10 == 0 and np.linalg.norm(v * (u @ kernel) - weight) < SINKHORN_ERROR:
            break
    plan: Array = u[:, None] * kernel * v
    return plan


def draw_pairs(plan: Array, n: int, rng: np.random.Generator) -> tuple[Index, Index]:
    """Draw n pairs from a plan (B, B) with replacement: row and column indices, each (n,)."""
    flat = plan.ravel().clip(min=0)
    drawn = rng.choice(flat.size, size=n, p=flat / flat.sum())
    rows, columns = np.divmod(drawn, plan.shape[1])
    return rows, columns


def _check_cost(cost: Array) -> Array:
    if np.iscomplexobj(cost) or np.ma.is_masked(cost):
        raise TypeError("cost must hold real numbers, none of them masked")
    whole = np.asarray(cost)
    if whole.dtype.kind in "iu" and whole.size and max(int(whole.max()), -int(whole.min())) > 2**53:
        raise ValueError("cost has integers above 2^53, which float64 rounds: subtract a constant")
    cost = np.ascontiguousarray(cost, dtype=np.float64)
    if cost.ndim != 2 or cost.shape[0] != cost.shape[1] or cost.size == 0:
        raise ValueError(f"cost must be a non-empty square matrix, got shape {cost.shape}")
    if not _is_finite(cost):
        raise ValueError("cost has NaN or infinite values")
    return cost


@compiled(fastmath={"reassoc", "nsz"})
def _is_finite(values: Array) -> bool:
    """Whether all numbers are finite: 0 times infinity is NaN."""
    total = 0.0
    for i in range(len(values)):
        for j in range(values.shape[1]):
            total += 0.0 * values[i, j]
    return total == 0
