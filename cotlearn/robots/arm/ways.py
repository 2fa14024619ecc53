"""Which way round the pillars a path went."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.arm.task import GOAL, KINDS, ROWS, TIP, pillars
from cotlearn.validation import check_choice

Array = NDArray[np.float64]


def way_round(paths: ArrayLike, kind: str) -> NDArray[np.int64]:
    """The number of the way in `task.WAYS[kind]` that each path took, -1 where it took none.

    It is told where the path passes a row of pillars for the last time. In "ring" that is the
    plane through the pillar across the direction from start to goal; the path went over the pillar
    if it is clearer of it upwards than sideways there, and else left or right. In "avoid" it is
    the plane x = the middle of the row; the gap is the number of pillars with a smaller y.

    Args:
        paths: (n, T, columns), states.
        kind: "ring" or "avoid".
    """
    states = np.asarray(paths, dtype=np.float64)
    if states.ndim != 3 or len(states) == 0 or states.shape[1] < 2:
        raise ValueError(f"paths must have shape (n, 2 steps or more, columns): {states.shape}")
    tip = states[..., TIP]
    posts = pillars(states[:, 0])
    if check_choice(kind, "kind", KINDS) == "ring":
        along = states[:, 0, GOAL][:, :2] - tip[:, 0, :2]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        offset = tip[..., :2] - posts[:, 0, None, :2]
        forward = (offset * along[:, None]).sum(axis=-1)
        sideways = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
        side, height, passed = _at(forward, np.stack([sideways, tip[..., 2]], axis=-1))
        over = height - posts[:, 0, 3] > np.abs(side) - posts[:, 0, 2]
        return np.where(~passed, -1, np.where(over, 2, np.where(side > 0, 0, 1)))
    way = np.zeros(len(states), dtype=np.int64)
    passed_all = np.ones(len(states), dtype=bool)
    first = 0
    for count in ROWS[kind]:
        row = posts[:, first : first + count]
        forward = tip[..., 0] - row[:, :, 0].mean(axis=1)[:, None]
        side, _, passed = _at(forward, tip[..., 1:])
        way = way * (count + 1) + (row[:, :, 1] < side[:, None]).sum(axis=1)
        passed_all &= passed
        first += count
    return np.where(passed_all, way, -1)


def _at(forward: Array, values: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Two values (n, T, 2) where forward (n, T) last rises through 0, and whether it does."""
    rising = (forward[:, :-1] < 0) & (forward[:, 1:] >= 0)
    passed = rising.any(axis=1)
    last = rising.shape[1] - 1 - rising[:, ::-1].argmax(axis=1)
    rows = np.arange(len(forward))
    before, after = forward[rows, last], forward[rows, last + 1]
    share = np.where(passed, -before / np.where(passed, after - before, 1.0), 0.0)[:, None]
    found = values[rows, last] * (1 - share) + values[rows, last + 1] * share
    return found[:, 0], found[:, 1], passed & (forward[:, -1] >= 0)
