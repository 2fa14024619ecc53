"""The agent's paths around the T: clearances and a visibility graph, in the frame of the T."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from cotlearn.robots.push_t.constants import AGENT_RADIUS, OUTLINE, RECTANGLES
from cotlearn.robots.task import Array

CLEAR = AGENT_RADIUS + 3.0  #: least distance of the agent's centre from the T on a path, pixels
_MARGIN = AGENT_RADIUS + 5.0  #: offset of the turning points from the corners along x and y

_CORNERS = np.array(OUTLINE)
_LOW, _HIGH = np.array(RECTANGLES).reshape(2, 1, 2, 2).transpose(3, 0, 1, 2)  #: (2, 1, 2) each
_OUTWARDS = np.array([(-1, -1), (1, -1), (1, 1), (1, 1), (-1, 1), (-1, 1)])
#: Shortest paths turn only at the six convex corners of the T.
TURNS = _CORNERS[[0, 1, 2, 4, 5, 7]] + _MARGIN * _OUTWARDS
_AROUND = np.array([(math.cos(a), math.sin(a)) for a in np.arange(24) * (2 * math.pi / 24)])

#: Path lengths (7, s) by the last node (the agent or a turning point), and Dijkstra's predecessors.
Found = tuple[Array, NDArray[np.int32]]


def distance(points: Array) -> Array:
    """Distance (n,) of points (n, 2) from the T; 0 inside."""
    outside = np.maximum(np.maximum(_LOW - points, points - _HIGH), 0.0)
    return np.asarray(np.hypot(outside[..., 0], outside[..., 1]).min(axis=0))


def clearance(a: Array, b: Array) -> Array:
    """Distance (n,) of segments from a (n, 2) to b (n, 2) from the T; 0 if they cross it."""
    way = b - a
    squared = np.maximum((way**2).sum(axis=1), 1e-12)
    to_corner = _CORNERS[:, None] - a
    share = np.clip((to_corner * way).sum(axis=2) / squared, 0.0, 1.0)
    nearest = np.linalg.norm(to_corner - share[..., None] * way, axis=2).min(axis=0)
    nearest = np.minimum(nearest, np.minimum(distance(a), distance(b)))
    return np.where(_crosses(a, way), 0.0, nearest)


def _crosses(a: Array, way: Array) -> NDArray[np.bool_]:
    inverse = 1.0 / np.where(np.abs(way) < 1e-12, 1e-12, way)
    first, second = (_LOW - a) * inverse, (_HIGH - a) * inverse  # (2, n, 2)
    enter = np.minimum(first, second).max(axis=2)
    leave = np.maximum(first, second).min(axis=2)
    return np.asarray(((enter <= leave) & (leave >= 0) & (enter <= 1)).any(axis=0))


def step_back(agent: Array) -> Array:
    """A nearby position that is clear of the T, from which paths can start; `agent` if clear."""
    if distance(agent[None])[0] >= CLEAR + 0.5:
        return agent
    for reach in (3.0, 6.0, 10.0, 16.0, 24.0, 40.0, 70.0):
        places = agent + reach * _AROUND
        free = distance(places)
        if free.max() >= CLEAR + 0.5:
            return places[int(free.argmax())]
    return agent


class Routes:
    """Shortest paths around the T to fixed positions.

    Args:
        places: (s, 2), positions at least `CLEAR` from the T.
    """

    def __init__(self, places: Array) -> None:
        self.places = places
        self._between = _legs(TURNS, TURNS)  # (6, 6)
        self._last = _legs(TURNS, places)  # (6, s)

    def lengths(self, agent: Array, usable: NDArray[np.bool_]) -> tuple[Array, Found]:
        """Lengths of the shortest paths from `agent` to all places; inf if there is no path.

        Args:
            agent: (2,), a position clear of the T.
            usable: (6,), which turning points lie in the world.

        Returns:
            The lengths (s,), and the paths for `way`.
        """
        legs = np.full((7, 7), np.inf)  # from the agent and the turning points, in this order
        legs[0, 1:] = np.where(usable, _legs(agent[None], TURNS)[0], np.inf)
        legs[1:, 1:] = np.where(usable[:, None] & usable, self._between, np.inf)
        reach, before = dijkstra(legs, indices=0, return_predecessors=True)
        through = reach[:, None] + np.vstack([_legs(agent[None], self.places), self._last])
        return through.min(axis=0), (through, before)

    def way(self, place: int, found: Found) -> Array:
        """The turning points (k, 2) between the agent and a place, from the paths of `lengths`."""
        through, before = found
        here = int(through[:, place].argmin())
        path: list[int] = []
        while here > 0:
            path.insert(0, here - 1)
            here = int(before[here])
        return TURNS[path]


def _legs(a: Array, b: Array) -> Array:
    """Lengths (n, m) of straight lines from a (n, 2) to b (m, 2); inf if they are not clear."""
    starts, ends = np.repeat(a, len(b), axis=0), np.tile(b, (len(a), 1))
    length = np.linalg.norm(ends - starts, axis=1)
    # 0.01: places exactly at the limit count as clear
    return np.where(clearance(starts, ends) >= CLEAR - 0.01, length, np.inf).reshape(len(a), len(b))
