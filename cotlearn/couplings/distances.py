"""Squared distances of rows: the costs of pairing."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.compiled import compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]

EPS = float(np.finfo(np.float64).eps)
MANY_DIMENSIONS = 12  #: columns from which a matrix product computes distances faster
HIDDEN = 1e-9  #: rounding errors of distances, as a share of what decides a plan, that are too much
LOST_DIGITS = 1e-6  #: share of the largest |a|^2 + |b|^2 below which the product loses digits


def to_numpy(value: Tensor | Array) -> Array:
    """A tensor as a contiguous float64 array on the CPU; shares memory if it is one already.

    An array comes back as it is, so that a batch is converted once.
    """
    if isinstance(value, np.ndarray):
        return value
    if value.dtype not in (torch.float32, torch.float64):  # such as bfloat16, which NumPy has not
        value = value.to("cpu", torch.float64)
    return np.asarray(value.numpy(force=True), np.float64, order="C")


def distances(first: Tensor, second: Tensor) -> Tensor:
    """|a_i - b_j|, also of rows that lie far from 0 and near each other."""
    return torch.cdist(first, second, compute_mode="donot_use_mm_for_euclid_dist")


def squared_distances(first: Tensor | Array, second: Tensor | Array) -> Array:
    """|a_i - b_j|^2 for all rows, float64, shape (len(first), len(second)).

    From 12 dimensions on, one matrix product of (-2a, |a|^2, 1) and (b, 1, |b|^2) is faster.
    Distances so small that the product loses digits are computed again directly, so that equal
    rows have distance 0.
    """
    a, b = to_numpy(first), to_numpy(second)
    if a.shape[1] >= MANY_DIMENSIONS:
        left, right, largest = _factors(np.ascontiguousarray(a), np.ascontiguousarray(b))
        # by torch: threads of NumPy's product and of torch would wait for each other, for 20 ms
        distances: Array = torch.mm(torch.from_numpy(left), torch.from_numpy(right).T).numpy()
        near = LOST_DIGITS * largest
        if distances.min() >= near:
            return distances
        rows, columns = np.nonzero(distances < near)
        if len(rows) < distances.size // 100:
            distances[rows, columns] = ((a[rows] - b[columns]) ** 2).sum(axis=1)
            return distances
    summed: Array = _summed(np.ascontiguousarray(a), np.ascontiguousarray(b.T))
    return summed


def pairing_cost(first: Tensor | Array, second: Tensor | Array) -> Array:
    """A cost (n, n) with the exact plans of |a_i - b_j|^2: that, or one without its constants.

    |a_i|^2 and |b_j|^2 change no plan, but where they are large, as of data far from 0, rounding
    hides the rest: -2 (a_i - E a) (b_j - E b).
    """
    first, second = to_numpy(first), to_numpy(second)
    cost = squared_distances(first, second)
    return centred_products(first, second) if hides(cost, first, second) else cost


def hides(cost: Array, first: Tensor | Array, second: Tensor | Array) -> bool:
    """Whether rounding of squared distances hides what decides their plans."""
    a, b = variances(to_numpy(first)), variances(to_numpy(second))
    scale = math.sqrt(a.max()) * math.sqrt(b.max())
    return bool(EPS * cost.max() > HIDDEN * scale > 0)


def centred_products(first: Tensor | Array, second: Tensor | Array) -> Array:
    """-2 (a_i - E a) (b_j - E b), whose exact plans are those of squared distances."""
    a, b = to_numpy(first), to_numpy(second)
    products: Array = -2 * (a - a.mean(axis=0)) @ (b - b.mean(axis=0)).T
    return products


@compiled()
def _factors(a: Array, b: Array) -> tuple[Array, Array, float]:
    """The matrices (-2a, |a|^2, 1) and (b, 1, |b|^2) of shifted rows; the largest |a|^2 + |b|^2."""
    d = a.shape[1]
    centre = np.zeros(d)
    for i in range(len(b)):
        for j in range(d):
            centre[j] += b[i, j]
    centre /= len(b)
    left, right = np.empty((len(a), d + 2)), np.empty((len(b), d + 2))
    largest_a, largest_b = 0.0, 0.0
    for i in range(len(a)):
        norm = 0.0
        for j in range(d):
            shifted = a[i, j] - centre[j]
            left[i, j] = -2 * shifted
            norm += shifted * shifted
        left[i, d], left[i, d + 1] = norm, 1.0
        largest_a = max(largest_a, norm)
    for i in range(len(b)):
        norm = 0.0
        for j in range(d):
            right[i, j] = b[i, j] - centre[j]
            norm += right[i, j] * right[i, j]
        right[i, d], right[i, d + 1] = 1.0, norm
        largest_b = max(largest_b, norm)
    return left, right, largest_a + largest_b


@compiled()
def _summed(a: Array, columns: Array) -> Array:
    """The squared distances of rows a (n, d) and of columns (d, m), in the order of their columns.

    SciPy's `cdist` gives the same bits in three times the time.
    """
    n, d, m = len(a), len(columns), columns.shape[1]
    distances = np.zeros((n, m))
    for i in range(n):
        for k in range(d):
            for j in range(m):
                apart = a[i, k] - columns[k, j]
                distances[i, j] += apart * apart
    return distances


@compiled()
def variances(values: Array) -> Array:
    """The variance of each column of (n, k), as NumPy's, whose call takes longer than the sums."""
    n, k = values.shape
    mean, found = np.zeros(k), np.zeros(k)
    for i in range(n):
        for j in range(k):
            mean[j] += values[i, j]
    mean /= n
    for i in range(n):
        for j in range(k):
            apart = values[i, j] - mean[j]
            found[j] += apart * apart
    return found / n


@compiled(fastmath={"reassoc", "nsz"})
def weigh(condition_cost: Array, weight: float, sample_cost: Array) -> float:
    """Make w C + S of C, in place, and return the mean of |S|."""
    total = 0.0
    for i in range(len(condition_cost)):
        for j in range(condition_cost.shape[1]):
            condition_cost[i, j] = weight * condition_cost[i, j] + sample_cost[i, j]
            total += abs(sample_cost[i, j])
    return total / sample_cost.size


@compiled()
def heeded(c: Array, noise_row: Index, data_row: Index) -> Array:
    """The squared difference of paired rows of c (n, k), as a share of that of random pairs, (k,).

    Of a constant column it is 0.
    """
    spread, shares = variances(c), np.zeros(c.shape[1])
    for j in range(c.shape[1]):
        for i in range(len(noise_row)):
            shares[j] += (c[noise_row[i], j] - c[data_row[i], j]) ** 2
        if spread[j] > 0:
            shares[j] /= 2 * spread[j] * len(noise_row)
    return shares


@compiled(fastmath={"reassoc", "nsz"})
def mean_distance(squared: Array) -> float:
    """The mean of the distances whose squares (n, m) are given."""
    total = 0.0
    for i in range(len(squared)):
        row = 0.0
        for j in range(squared.shape[1]):
            row += math.sqrt(squared[i, j])
        total += row
    return total / squared.size


def near_rows(weight: float, condition_cost: Array, sample_cost: Array) -> float:
    """Mean number of conditions per row whose weighted cost is at most the mean sample cost."""
    return float((weight * condition_cost <= sample_cost.mean()).sum(axis=1).mean())
