"""How much of the goal the T covers: an exact area, without clipping a polygon.

The part of a polygon P inside the rectangle [x0, x1] × [y0, y1] has the area

    ∫ over y in [y0, y1] of the length of P's cut at height y inside [x0, x1].

A cut is made of intervals [a, b] between two edges of P, and inside [x0, x1] such an interval has
the length clamp(b) - clamp(a). Summed over the edges, taken around P, the area is

    Σ over edges ∫ clamp(x(y)) dy,   y along the edge, inside [y0, y1],

and the mean of a clamped linear function has a closed form. Nothing is divided by a difference that
could vanish, so edges that lie on one another do no harm.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.task import AREA, GOAL, OUTLINE, RECTANGLES
from cotlearn.robots.task import Array

_OUTLINE = np.array(OUTLINE)
_COS_GOAL, _SIN_GOAL = math.cos(GOAL[2]), math.sin(GOAL[2])
#: Farther from the goal than twice the reach of the T, nothing is covered.
_REACH = 2 * max(math.hypot(x, y) for x, y in OUTLINE)


def corners(pose: ArrayLike, points: ArrayLike = OUTLINE) -> Array:
    """Points of the T in the world.

    Args:
        pose: (..., 3), x, y and angle of the T.
        points: (m, 2), in the frame of the T; by default the corners of its outline.

    Returns:
        (..., m, 2).
    """
    pose, points = np.asarray(pose, dtype=np.float64), np.asarray(points, dtype=np.float64)
    angle = pose[..., 2, None]
    return rotate(points, np.cos(angle), np.sin(angle)) + pose[..., None, :2]


def coverage(pose: ArrayLike) -> Array:
    """The share of the goal's area that the T covers, exact, for any number of poses.

    Args:
        pose: (..., 3), x, y and angle of the T in the world.

    Returns:
        (...), in [0, 1].
    """
    pose = np.asarray(pose, dtype=np.float64)
    place = rotate(pose[..., :2] - GOAL[:2], _COS_GOAL, -_SIN_GOAL)
    points = corners(np.concatenate([place, pose[..., 2:] - GOAL[2]], axis=-1))
    x, y = points[..., 0], points[..., 1]
    area = sum(_area_inside(x, y, rectangle) for rectangle in RECTANGLES)
    return np.clip(area / AREA, 0.0, 1.0)


def nearest_side(agent: ArrayLike, pose: ArrayLike) -> NDArray[np.int64]:
    """The side of the T that is nearest to the agent, (n,), 0 to 7 around the outline.

    Args:
        agent: (n, 2), places in the world.
        pose: (n, 3), x, y and angle of the T.
    """
    point = np.asarray(agent)[:, None]
    first = corners(pose)
    along = np.roll(first, -1, axis=1) - first
    share = ((point - first) * along).sum(axis=-1) / (along**2).sum(axis=-1)
    nearest = first + share.clip(0, 1)[..., None] * along
    return np.asarray(((point - nearest) ** 2).sum(axis=-1).argmin(axis=1), dtype=np.int64)


def _area_inside(x: Array, y: Array, rectangle: tuple[float, float, float, float]) -> Array:
    """Area of polygons with corners x, y of shape (..., m) inside one rectangle."""
    x0, x1, y0, y1 = rectangle
    next_x, next_y = np.roll(x, -1, axis=-1), np.roll(y, -1, axis=-1)
    low, high = np.clip(y, y0, y1), np.clip(next_y, y0, y1)
    inside = low != high
    start = x + _ratio(low - y, next_y - y, inside) * (next_x - x)
    end = x + _ratio(high - y, next_y - y, inside) * (next_x - x)
    return (_clamped_mean(start, end, x0, x1) * (high - low)).sum(axis=-1)


def _clamped_mean(start: Array, end: Array, x0: float, x1: float) -> Array:
    """Mean of clamp(x, x0, x1) while x goes from `start` to `end`."""
    first, last = np.clip(start, x0, x1), np.clip(end, x0, x1)
    # the share of the way that x rests at `first`, less the share that it rests at `last`
    surplus = _ratio((first - start) - (end - last), end - start, first != last)
    return (first + last) / 2 + surplus * (first - last) / 2


def _ratio(a: Array, b: Array, where: NDArray[np.bool_]) -> Array:
    return np.divide(a, b, out=np.zeros_like(a), where=where)


def coverage_of_one(x: float, y: float, angle: float) -> float:
    """`coverage` of a single pose, in plain Python: for one pose, ten times as fast."""
    dx, dy = x - GOAL[0], y - GOAL[1]
    if dx * dx + dy * dy > _REACH * _REACH:
        return 0.0
    x, y = _COS_GOAL * dx + _SIN_GOAL * dy, _COS_GOAL * dy - _SIN_GOAL * dx
    cos, sin = math.cos(angle - GOAL[2]), math.sin(angle - GOAL[2])
    points = [(cos * px - sin * py + x, sin * px + cos * py + y) for px, py in OUTLINE]
    area = 0.0
    for x0, x1, y0, y1 in RECTANGLES:
        xa, ya = points[-1]
        for xb, yb in points:
            low = y0 if ya < y0 else y1 if ya > y1 else ya
            high = y0 if yb < y0 else y1 if yb > y1 else yb
            if low != high:
                start = xa + (low - ya) / (yb - ya) * (xb - xa)
                end = xa + (high - ya) / (yb - ya) * (xb - xa)
                first = x0 if start < x0 else x1 if start > x1 else start
                last = x0 if end < x0 else x1 if end > x1 else end
                mean = (first + last) / 2
                if first != last:
                    mean += ((first - start) - (end - last)) / (end - start) * (first - last) / 2
                area += mean * (high - low)
            xa, ya = xb, yb
    return min(max(area / AREA, 0.0), 1.0)
