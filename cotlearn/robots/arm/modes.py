"""The mode of a path: on which side the tip passes the pillars."""

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.arm.constants import GOAL, ROWS, TIP, pillars
from cotlearn.robots.task import Array


def mode_of_path(paths: Array, kind: str) -> NDArray[np.int64]:
    """The mode of each path, an index of `constants.MODES[kind]`: how the tip passes the pillars.

    The mode is read where the path crosses the plane of a row of pillars for the last time; it is
    -1 if the path does not cross a plane or turns back. In "ring" the plane goes through the
    pillar, perpendicular to the direction from start to goal. The mode is "over" if the tip clears
    the pillar by more in height than to the side, else "left" or "right". In "avoid" the plane is
    x = the row's middle, and the gap is the number of pillars with a smaller y.

    Args:
        paths: (n, T, columns), states.
        kind: "ring" or "avoid".

    Returns:
        (n,).
    """
    tip = paths[..., TIP]
    posts = pillars(paths[:, 0])
    if kind == "ring":
        along = paths[:, 0, GOAL][:, :2] - tip[:, 0, :2]
        along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
        offset = tip[..., :2] - posts[:, 0, None, :2]
        forward = (offset * along[:, None]).sum(axis=-1)
        sideways = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
        side, height, passed = _at_last_pass(forward, np.stack([sideways, tip[..., 2]], axis=-1))
        over = height - posts[:, 0, 3] > np.abs(side) - posts[:, 0, 2]
        return np.where(~passed, -1, np.where(over, 2, np.where(side > 0, 0, 1)))
    mode = np.zeros(len(paths), dtype=np.int64)
    passed_all = np.ones(len(paths), dtype=bool)
    for row in np.split(posts, np.cumsum(ROWS[kind])[:-1], axis=1):
        forward = tip[..., 0] - row[:, :, 0].mean(axis=1)[:, None]
        side, _, passed = _at_last_pass(forward, tip[..., 1:])
        mode = mode * (row.shape[1] + 1) + (row[:, :, 1] < side[:, None]).sum(axis=1)
        passed_all &= passed
    return np.where(passed_all, mode, -1)


def _at_last_pass(forward: Array, values: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Interpolate values (n, T, 2) where forward (n, T) last rises through 0; whether it does."""
    rising = (forward[:, :-1] < 0) & (forward[:, 1:] >= 0)
    passed = rising.any(axis=1)
    last = rising.shape[1] - 1 - rising[:, ::-1].argmax(axis=1)
    rows = np.arange(len(forward))
    before, after = forward[rows, last], forward[rows, last + 1]
    share = np.where(passed, -before / np.where(passed, after - before, 1.0), 0.0)[:, None]
    found = values[rows, last] * (1 - share) + values[rows, last + 1] * share
    return found[:, 0], found[:, 1], passed & (forward[:, -1] >= 0)
