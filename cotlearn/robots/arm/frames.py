"""The arm's goal frame: x axis from the tip to the goal."""

import functools

import numpy as np

from cotlearn.robots.arm import constants
from cotlearn.robots.plane import rotate
from cotlearn.robots.task import Array, Frame

_NEAR = 0.03  #: metres from the goal within which the direction to it counts less


class GoalFrame(Frame):
    """A frame with the tip as its origin and the x axis in the direction of the goal.

    Origin and direction are those of the last state. The variance of actions given the condition is
    the same in all rigid frames, so a frame only removes variance *between* conditions. Of the
    frames that were tried (origin at the base, tip, goal or pillars; x axis fixed, or from the tip
    or the pillars to the goal) this one has the least variance for chunks of both kinds and for the
    whole paths of "ring". Whole paths of "avoid" vary as little in the world frame, where the rows
    of pillars hardly move. Near the goal, where the direction to it means little, the x axis turns
    towards the direction from the pillars to the goal.

    Observed states hold tip, goal and pillars in this frame, with heights above the table. Actions
    are relative to the tip, also in height.

    Args:
        kind: "ring" or "avoid".
    """

    def __init__(self, kind: str) -> None:
        super().__init__(features=len(constants.columns(kind)))

    def observe(self, history: Array) -> Array:
        """Transform states (B, T, columns) to the frame of the last state, (B, T, columns)."""
        origin, cos, sin = _frame(history)
        seen = history.copy()
        for first in (0, 3, *range(constants.FIRST_PILLAR, history.shape[-1], 4)):
            place = slice(first, first + 2)
            seen[..., place] = rotate(history[..., place] - origin[..., :2], cos, -sin)
        return seen

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Transform world actions (B, n, 3) to the frame of the last state."""
        origin, cos, sin = _frame(history)
        away = actions - origin
        return np.concatenate([rotate(away[..., :2], cos, -sin), away[..., 2:]], axis=-1)

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        origin, cos, sin = _frame(history)
        away = np.concatenate([rotate(actions[..., :2], cos, sin), actions[..., 2:]], axis=-1)
        return origin + away


def _frame(history: Array) -> tuple[Array, Array, Array]:
    """Origin (B, 1, 3), and cosine and sine (B, 1) of the direction of the x axis."""
    norm = functools.partial(np.linalg.norm, axis=-1, keepdims=True)
    last = history[:, -1:]
    goal = last[..., constants.GOAL][..., :2]
    past = goal - constants.pillars(last)[..., :2].mean(axis=-2)
    along = goal - last[..., :2] + _NEAR * past / norm(past)
    along = np.where(norm(along) < 1e-6, past, along)  # they cancel out
    cos, sin = np.moveaxis(along / norm(along), -1, 0)
    return last[..., constants.TIP], cos, sin
