"""Paths of the tip: via points, minimum-jerk splines and clearance."""

import numpy as np
from numpy.typing import ArrayLike

from cotlearn.robots.arm import constants
from cotlearn.robots.task import Array

CLEARANCE = 0.018  #: metres between rod and pillars that a path must keep
_BESIDE = (0.02, 0.05)  #: metres between rod and pillar where the path passes it
_ABOVE = (0.03, 0.06)  #: metres between tip and pillar where the path goes over it
_RISE = (0.0, 0.03)  #: metres above the line from start to goal, of a path beside the pillar
_ENTRY = 0.03  #: metres before and behind a row between which a path goes straight
_MIDDLE = 0.3  #: largest offset from the middle of a gap, as a share of half its width
_SPREAD = 0.015  #: largest random offset of a via point along the path, metres


def via_points(state: Array, mode: int, kind: str, generator: np.random.Generator) -> Array:
    """Draws the via points (k, 3) of a path between start and goal.

    Args:
        state: (columns,), the start state.
        mode: an index of `constants.MODES[kind]`.
        kind: "ring" or "avoid".
        generator: source of randomness.
    """
    start, goal = state[constants.TIP], state[constants.GOAL]
    posts = constants.pillars(state)
    draw = generator.uniform
    if kind == "ring":
        x, y, radius, height = posts[0]
        along = (goal - start)[:2] / np.linalg.norm((goal - start)[:2])
        left = np.array([-along[1], along[0]])
        place = np.array([x, y]) + draw(-_SPREAD, _SPREAD) * along
        if constants.MODES[kind][mode] == "over":
            place = place + draw(-0.5, 0.5) * radius * left
            return np.array([[*place, height + draw(*_ABOVE)]])
        side = 1.0 if constants.MODES[kind][mode] == "left" else -1.0
        place = place + side * (radius + constants.ROD_RADIUS + draw(*_BESIDE)) * left
        return np.array([[*place, (start[2] + goal[2]) / 2 + draw(*_RISE)]])
    points = []
    first, second = constants.ROWS[kind]
    rows = posts[:first], posts[first:]
    for row, gap in zip(rows, divmod(mode, second + 1), strict=True):
        place = row[:, 0].mean()
        share = (place - start[0]) / (goal[0] - start[0])
        z = start[2] + share * (goal[2] - start[2])
        y = _through(row, gap, generator)
        points += [[place - _ENTRY, y, z], [place + _ENTRY, y, z]]
    return np.array(points)


def _through(row: Array, gap: int, generator: np.random.Generator) -> float:
    """Draw the y at which to pass a row of pillars (count, 4), sorted by y, in gap 0 to count."""
    edge = row[:, 2] + constants.ROD_RADIUS
    if gap == 0:
        return float(row[0, 1] - edge[0] - generator.uniform(*_BESIDE))
    if gap == len(row):
        return float(row[-1, 1] + edge[-1] + generator.uniform(*_BESIDE))
    low, high = row[gap - 1, 1] + edge[gap - 1], row[gap, 1] - edge[gap]
    off = _MIDDLE * generator.uniform(-1, 1) * (high - low) / 2
    return float((low + high) / 2 + off)


def minimum_jerk(points: ArrayLike, times: ArrayLike, at: ArrayLike) -> Array:
    """The path with the least ∫|jerk|² dt through given points at given times, from rest to rest.

    It is the quintic spline through the points, whose first four derivatives are continuous (Flash
    and Hogan 1985).

    Args:
        points: (k + 2, d), start, via points, goal.
        times: (k + 2,), increasing times of the points.
        at: (n,), times at which to evaluate, from the first to the last of `times`.

    Returns:
        (n, d).
    """
    from scipy.interpolate import make_interp_spline  # late: it takes a second

    still = np.zeros((2, np.shape(points)[1]))
    at_rest = list(zip((1, 2), still, strict=True))  # no speed, no acceleration
    return np.asarray(make_interp_spline(times, points, k=5, bc_type=(at_rest, at_rest))(at))


def clearance(tips: Array, posts: Array) -> Array:
    """Distance (n,) between the rod and the nearest pillar, metres; negative if they overlap.

    Args:
        tips: (n, 3), positions of the tip.
        posts: (p, 4), x, y, radius and height of the pillars.
    """
    aside = np.linalg.norm(tips[:, None, :2] - posts[:, :2], axis=2)
    above = tips[:, None, 2] + constants.ROD_RADIUS - (posts[:, 3] - posts[:, 2])
    apart = np.hypot(aside, np.maximum(above, 0.0)) - posts[:, 2] - constants.ROD_RADIUS
    return np.asarray(apart.min(axis=1))
