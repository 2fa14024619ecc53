"""Nearly optimal dual potentials of an assignment, by a few Sinkhorn steps in single precision.

Numba compiles these loops when they are first called, as in `augmenting.py`, which makes the
assignment exact.
"""

import math

import numpy as np
from numpy.typing import NDArray

from cotlearn.couplings.compiled import at_rank, compiled

Array = NDArray[np.float64]
Single = NDArray[np.float32]

FAR = 8.0  #: if mean - least cost exceeds this many deviations, it sets the scale of the costs
TEMPERATURE = np.float32(0.1)  #: of the first steps, in units of the costs' scale
COOLING = 5  #: each further temperature is lower by this factor
STAGES = 2, 5  #: least and greatest number of temperatures
STEPS, FEW_STEPS = 10, 6  #: Sinkhorn steps at each temperature; up to 512 rows fewer are faster
LEAST = np.float32(1e-12)  #: scalings stay in [1e-12, 1e12]
#: Entries of the kernel are 0 or at least 1e-25, so that their products with scalings are normal
#: numbers: on some processors an operation on a denormal number takes a hundred times as long.
SMALLEST = np.float32(-57)  #: exponent, below which an entry is 0
SMALL = np.float32(1e-5)  #: an entry below this is 0 after its fifth power
ZERO, ONE = np.float32(0), np.float32(1)


def survey(cost: Array) -> tuple[Array, float, float, int]:
    """Measure what decides how to solve: least costs, two scales, and how many rows are easy.

    Args:
        cost: (B, B), finite.

    Returns:
        The smallest cost of each column, (B,); the larger of the costs' standard deviation and
        (mean - least cost) / `FAR`; the median over sampled rows of the first decile less the
        minimum; the number of columns that are the cheapest of some row in cost_ij - least_j.
    """
    least, taken = _cheapest(cost)
    mean, deviation = _moments(cost[:: max(1, len(cost) // 32)])
    spread = max(deviation, (mean - float(least.min())) / FAR)
    return least, spread, nearness(cost), taken


@compiled()
def nearness(cost: Array) -> float:
    """How far the lowest costs (B, B) of a row lie apart: its first decile less its minimum."""
    n = len(cost)
    some = cost[:: max(1, n // 8)]
    tenths = np.empty(len(some))
    for i in range(len(some)):
        tenths[i] = at_rank(some[i], n // 10) - at_rank(some[i], 0)
    middle = len(some) // 2
    return (at_rank(tenths, middle) + at_rank(tenths, len(some) - 1 - middle)) / 2


@compiled(fastmath={"reassoc", "nsz"})
def _moments(some: Array) -> tuple[float, float]:
    """The mean and the standard deviation of (n, m)."""
    total, squares = 0.0, 0.0
    for i in range(len(some)):
        for j in range(some.shape[1]):
            total += some[i, j]
    mean = total / some.size
    for i in range(len(some)):
        for j in range(some.shape[1]):
            squares += (some[i, j] - mean) ** 2
    return mean, math.sqrt(squares / some.size)


@compiled(fastmath={"nnan", "nsz"})
def _cheapest(cost: Array) -> tuple[Array, int]:
    """The first and the last result of `survey`, without a second matrix of this size.

    Two large matrices, made and freed for each batch, would cost more than these loops: the
    allocator gives their memory back to the system each time.
    """
    n = len(cost)
    least = cost[0].copy()
    for i in range(1, n):
        for j in range(n):
            least[j] = min(least[j], cost[i, j])
    taken = np.zeros(n, np.bool_)
    for i in range(n):
        lowest = np.inf
        for j in range(n):
            lowest = min(lowest, cost[i, j] - least[j])
        best = 0
        while cost[i, best] - least[best] != lowest:  # a loop without this branch is vectorised
            best += 1
        taken[best] = True
    return least, int(taken.sum())


@compiled(fastmath=True)
def potentials(cost: Array, least: Array, spread: float, near: float) -> tuple[Array, Array]:
    """Potentials f, g: f_i + g_j is near cost_ij on optimal pairs, and not far above it elsewhere.

    Args:
        cost: (B, B), finite.
        least: (B,), the smallest cost of each column.
        spread: scale of the costs, above 0.
        near: scale of a row's lowest costs. Where clusters lie far apart it is much smaller than
            `spread`, and more temperatures follow.

    Returns:
        f and g, each (B,).
    """
    n = len(cost)
    kernel, sums = np.empty((n, n), np.float32), np.empty(n, np.float32)
    rows, columns = np.zeros(n), least.copy()
    _start(kernel, cost, least, float(-1 / (TEMPERATURE * spread)))
    temperature = TEMPERATURE * spread
    coldest = near / min(20.0, n / 25)  # in large batches lower temperatures pay for themselves
    for stage in range(1, STAGES[1] + 1):
        u, v = np.ones(n, np.float32), np.ones(n, np.float32)
        for _ in range(FEW_STEPS if n <= 512 else STEPS):
            _step(kernel, u, v, sums)
        for j in range(n):  # exact for the columns: no entry of the next kernel is above 1
            v[j] = ONE / (sums[j] + LEAST)
        for i in range(n):
            rows[i] += temperature * math.log(u[i])
            columns[i] += temperature * math.log(v[i])
        if stage >= STAGES[0] and temperature <= coldest:
            break
        temperature /= COOLING
        _cool(kernel, u, v)
    return rows, columns


@compiled(fastmath=True)
def _start(kernel: Single, cost: Array, least: Array, per_unit: float) -> None:
    """The kernel at the first temperature, in place.

    An exponential would take a third of the time. Here exp(x) is (1 + x/256 + (x/256)^2 / 2)^256,
    by eight squarings: .3 % off at x = -10.
    """
    n = len(cost)
    for i in range(n):
        for j in range(n):
            exponent = max(np.float32((cost[i, j] - least[j]) * per_unit), SMALLEST)
            part = exponent * np.float32(1 / 256)
            entry = ONE + part + np.float32(0.5) * part * part
            for _ in range(8):
                entry *= entry
            kernel[i, j] = entry if exponent > SMALLEST else ZERO


@compiled(fastmath=True)
def _cool(kernel: Single, u: Single, v: Single) -> None:
    """The scaled kernel's fifth power, in place: that at a fifth of the temperature."""
    n = len(u)
    for i in range(n):
        for j in range(n):
            entry = kernel[i, j] * u[i] * v[j]
            square = entry * entry
            kernel[i, j] = square * square * entry if entry > SMALL else ZERO


@compiled(fastmath=True)
def _step(kernel: Single, u: Single, v: Single, sums: Single) -> None:
    """One over-relaxed Sinkhorn step of u and v in place; `sums` becomes u kernel."""
    n = len(u)
    sums[:] = 0
    for i in range(n):
        product = np.float32(0)
        for j in range(n):
            product += kernel[i, j] * v[j]
        u[i] = _relaxed(u[i], product)
        for j in range(n):
            sums[j] += kernel[i, j] * u[i]
    for j in range(n):
        v[j] = _relaxed(v[j], sums[j])


@compiled(fastmath=True, inline="always")
def _relaxed(scaling: np.float32, product: np.float32) -> np.float32:
    """The scaling moved towards 1 / product, and beyond it by over-relaxation of 1.375.

    A step may be over-relaxed by a power from 1 to 2 (Thibault 1711.01851). This one needs square
    roots only: a general power would take a quarter of the time.
    """
    ratio = scaling * product + LEAST
    quarter = math.sqrt(math.sqrt(ratio))
    moved = scaling / (ratio * quarter * math.sqrt(quarter))
    return np.float32(min(max(moved, LEAST), ONE / LEAST))
