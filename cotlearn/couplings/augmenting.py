"""Exact assignment from nearly optimal potentials by shortest augmenting paths.

The classical method (Jonker and Volgenant 1987) adds one row at a time, along the shortest path in
reduced costs to a free column. Good potentials make these paths short, but each row on a path still
scans all B columns. Here a row first scans only its near columns (about 16, whose reduced cost is
below a threshold) and puts a marker into the queue: "all other columns are at least d away". Only
if the search reaches distance d does the row scan all columns. What lies beyond the nearest free
column found so far is left out. The result is exact for any potentials and any threshold; they only
change the time.

Only this file, `annealing.py` and `distances.py` need compiled loops. Numba compiles them on the
first call (a few seconds, kept in a cache).
"""

import heapq

import numpy as np
from numpy.typing import NDArray

from cotlearn.couplings.compiled import at_rank, compiled

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ROOM = 3  #: near columns for which there is room, as a multiple of those expected
SCANS = 16  #: scans of all columns, for each row on average, after which SciPy is faster


def assign(cost: Array, rows: Array, columns: Array) -> Index | None:
    """The permutation p that minimises sum_i cost[i, p[i]].

    Args:
        cost: (B, B), finite.
        rows: (B,), potentials of the rows.
        columns: (B,), potentials of the columns.

    Returns:
        (B,), the column of each row; None if the search was given up, because ties or potentials
        of no use make the paths long: ordinary costs need fewer than 7 scans for each row, small
        integers half of B.
    """
    found: Index = _assign(cost, rows, columns, _threshold(cost, rows, columns))
    return found if found[-1] >= 0 else None


@compiled()
def _threshold(cost: Array, rows: Array, columns: Array) -> float:
    """A reduced cost that `_expected` columns of a row have at most."""
    n = len(cost)
    some = np.arange(0, n, max(1, n // 16))
    reduced = np.empty((len(some), n))
    for k in range(len(some)):
        for j in range(n):
            reduced[k, j] = cost[some[k], j] - rows[some[k]] - columns[j]
    return at_rank(reduced.ravel(), _expected(n) * reduced.size // n)


@compiled(inline="always")
def _expected(n: int) -> int:
    """Near columns of a row, on average."""
    return max(16, n // 32)


@compiled(fastmath={"nnan", "nsz", "reassoc"})
def _reduce(
    cost: Array, row: float, columns: Array, near: float, reduced: Array
) -> tuple[float, float]:
    """The reduced costs of a row, (n,), in place; the least of all, and of those above `near`."""
    least, beyond = np.inf, np.inf
    for j in range(len(cost)):
        reduced[j] = cost[j] - row - columns[j]
        least = min(least, reduced[j])
        beyond = min(beyond, reduced[j] if reduced[j] > near else np.inf)
    return least, beyond


@compiled()
def _keep(reduced: Array, near: float, column: Index, cost: Array, n: int) -> int:
    """Append what is at most `near`, with its columns, to n that are there; how many they are.

    A number is written in any case, which costs less than a branch that nobody can foresee.
    """
    for j in range(len(reduced)):
        column[n], cost[n] = j, reduced[j]
        n += reduced[j] <= near
    return n


@compiled()
def _assign(cost: Array, rows: Array, columns: Array, near: float) -> Index:
    """`assign`, where near columns are those whose reduced cost is at most `near`; -1: given up."""
    n, scans = len(cost), 0
    room = ROOM * _expected(n) * n
    near_column, near_cost = np.empty(room, np.int64), np.empty(room)
    first = np.zeros(n + 1, np.int64)  # where the near columns of each row begin
    beyond = np.empty(n)  # least reduced cost of the columns that are not near
    reduced, column_of, row_of = np.empty(n), np.full(n, -1), np.full(n, -1)
    for i in range(n):  # every row takes its cheapest column if it is free
        least, beyond[i] = _reduce(cost[i], rows[i], columns, near, reduced)
        if first[i] + n <= room:
            first[i + 1] = _keep(reduced, near, near_column, near_cost, first[i])
        else:  # near columns without end: ties
            first[i + 1], beyond[i] = first[i], least
        best = 0
        while reduced[best] != least:
            best += 1
        if row_of[best] < 0:
            row_of[best], column_of[i] = i, best

    price = np.zeros(n)  # of each column, added to its potential; it never rises
    distance, before = np.full(n, np.inf), np.full(n, -1)
    settled, reached = np.zeros(n, np.bool_), np.empty(n, np.int64)
    queue = [(0.0, 0)]
    for start in range(n):
        if column_of[start] >= 0:
            continue
        queue.clear()
        row, n_reached, bound = start, 0, np.inf  # bound: distance to the nearest free column
        offset = 0.0  # distance to the row less its reduced cost
        while True:
            for k in range(first[row], first[row + 1]):
                j = near_column[k]
                longer = offset + near_cost[k] - price[j]
                if longer < min(bound, distance[j]) and not settled[j]:
                    if distance[j] == np.inf:
                        reached[n_reached] = j
                        n_reached += 1
                    distance[j], before[j] = longer, row
                    heapq.heappush(queue, (longer, j))
                    if row_of[j] < 0:
                        bound = longer
            if offset + beyond[row] < bound:
                heapq.heappush(queue, (offset + beyond[row], n + row))  # the marker
            while True:
                length, node = heapq.heappop(queue)
                if node < n:
                    if settled[node] or length > distance[node]:
                        continue  # a shorter path reached it in the meantime
                    break
                far = node - n
                scans += 1
                if scans > SCANS * n:
                    column_of[:] = -1
                    return column_of
                offset = length - beyond[far]
                for j in range(n):
                    longer = offset + cost[far, j] - rows[far] - columns[j] - price[j]
                    if longer < min(bound, distance[j]) and not settled[j]:
                        if distance[j] == np.inf:
                            reached[n_reached] = j
                            n_reached += 1
                        distance[j], before[j] = longer, far
                        heapq.heappush(queue, (longer, j))
                        if row_of[j] < 0:
                            bound = longer
            if row_of[node] < 0:
                break
            settled[node] = True
            row = row_of[node]
            offset = length - (cost[row, node] - rows[row] - columns[node] - price[node])
        for k in range(n_reached):
            j = reached[k]
            if settled[j]:
                price[j] += distance[j] - length
                settled[j] = False
            distance[j] = np.inf
        while True:  # every row on the path moves to the next column
            row = before[node]
            row_of[node] = row
            column_of[row], node = node, column_of[row]
            if row == start:
                break
    return column_of
