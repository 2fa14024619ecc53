"""Value iteration: the number of control steps from any pose of the T to the goal.

The T's pose relative to the goal is (x, y, angle): the offset of its centre of gravity in the frame
of the goal, and its rotation. A push moves (x, y, angle) to ((x, y) + R(angle) shift,
angle + turn). The value of a pose is

    V = min over pushes of (steps of the push + steps to get there + V after the push),

and 0 where the goal is reached. The grid is fine near the goal and coarse far from it.
"""

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.constants import GOAL
from cotlearn.robots.push_t.expert.pushes import MIDDLE, Pushes, library
from cotlearn.robots.push_t.geometry import corners, coverage
from cotlearn.robots.task import Array

Single = NDArray[np.float32]


def _nodes(farthest: float, count: int, bend: float) -> Array:
    """Nodes from -farthest to farthest; the larger `bend`, the finer they lie near 0."""
    return farthest / math.sinh(bend) * np.sinh(bend * np.linspace(-1, 1, count))


PLACES = _nodes(320.0, 35, 4.2)  #: nodes of the grid along x and y, pixels
TURNS = _nodes(math.pi, 45, 3.2)  #: nodes along the angle, radians
APPROACH = 10.0  #: average number of steps from one push to the next
ENOUGH = 0.957  #: coverage that a plan aims at, a little above the success threshold
CELL = 0.551734  #: width of a cell of effects; planning uses one push per cell, about 400
SWEEPS = 11  #: sweeps of value iteration; the last one changes no value by more than 0.05


@dataclass(frozen=True)
class Value:
    """Steps to the goal, interpolated on the grid.

    Attributes:
        table: (35, 35, 45) at `PLACES`, `PLACES` and `TURNS`.
    """

    table: Array

    def __call__(self, relative: Array) -> Array:
        """The value (n,) of relative poses (n, 3), clipped to the grid."""
        from scipy.interpolate import interpn  # late: it takes a second

        places = relative[:, :2].clip(PLACES[0], PLACES[-1])
        turns = _wrap(relative[:, 2]).clip(TURNS[0], TURNS[-1])
        at = np.column_stack([places, turns])
        return np.asarray(interpn((PLACES, PLACES, TURNS), self.table, at))


def relative_pose(pose: Array) -> Array:
    """The pose (3,) of the T relative to the goal, from its pose (3,) in the world."""
    away = corners(pose, [MIDDLE])[0] - corners(GOAL, [MIDDLE])[0]
    place = rotate(away, math.cos(GOAL[2]), -math.sin(GOAL[2]))
    return np.array([*place, _wrap(pose[2] - GOAL[2])])


def world_pose(relative: Array) -> Array:
    """World poses (n, 3) of relative poses (n, 3), the inverse of `relative_pose`."""
    angle = relative[:, 2] + GOAL[2]
    middle = corners(GOAL, relative[:, :2] + MIDDLE)
    return np.column_stack([middle - rotate(MIDDLE, np.cos(angle), np.sin(angle)), angle])


def after(relative: Array, pushes: Pushes) -> Array:
    """Relative poses (m, 3) after each of m pushes from the relative pose (3,)."""
    shift = rotate(pushes.shift, math.cos(relative[2]), math.sin(relative[2]))
    return np.column_stack([relative[:2] + shift, relative[2] + pushes.turn])


def reached(relative: Array) -> NDArray[np.bool_]:
    """Whether relative poses (n, 3) cover more than `ENOUGH` of the goal, (n,)."""
    near = np.flatnonzero((np.abs(relative[:, 0]) < 8.0) & (np.abs(relative[:, 1]) < 8.0))
    near = near[np.abs(_wrap(relative[near, 2])) < 0.15]
    found = np.zeros(len(relative), dtype=bool)
    found[near] = coverage(world_pose(relative[near])) > ENOUGH
    return found


@functools.lru_cache(maxsize=1)
def value() -> Value:
    """The value of every pose, by value iteration over a subset of the library (6 s)."""
    pushes = _spread_out(library())
    grid = np.stack(np.meshgrid(PLACES, PLACES, TURNS, indexing="ij"), axis=-1)
    at_goal = reached(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    table = np.hypot(grid[..., 0], grid[..., 1]) / 8 + np.abs(grid[..., 2]) * 10 + APPROACH
    table = np.where(at_goal, 0.0, table).astype(np.float32)  # twice as fast as in double
    moves = [_move(angle, pushes) for angle in TURNS]
    cost = (pushes.steps + APPROACH).astype(np.float32)[:, None, None]
    for _ in range(SWEEPS):
        table = np.stack([_improved(table, move, cost) for move in moves], axis=2)
        table[at_goal] = 0.0
    return Value(table.astype(np.float64))


Move = tuple[Single, Single, Single, tuple[NDArray[np.int64], ...]]


def _move(angle: float, pushes: Pushes) -> Move:
    """The transitions of all pushes from all positions at one angle.

    Returns the interpolation weights of the nodes along x, y and angle after each push,
    (m, 35, 35), (m, 35, 35) and (m, 45), and the pushes and nodes from which the goal is reached.
    """
    x, y, turn = after(np.array([0.0, 0.0, angle]), pushes).T
    x, y = x[:, None] + PLACES, y[:, None] + PLACES
    moved = np.broadcast_arrays(x[:, :, None], y[:, None, :], turn[:, None, None])
    done = reached(np.stack(moved, axis=-1).reshape(-1, 3)).reshape(moved[0].shape)
    weights = _weights(x, PLACES), _weights(y, PLACES), _weights(_wrap(turn), TURNS)
    return *weights, np.nonzero(done)


def _improved(table: Single, move: Move, cost: Single) -> Single:
    """The least cost (35, 35) over all pushes, at one angle."""
    x, y, turn, done = move
    future = x @ np.tensordot(turn, table, axes=(1, 2)) @ y.swapaxes(1, 2)
    future[done] = 0.0
    return np.asarray((future + cost).min(axis=0))


def _weights(values: Array, nodes: Array) -> Single:
    """Weights (..., nodes) of linear interpolation at values (...), clipped to the nodes."""
    each = [np.interp(values, nodes, node) for node in np.eye(len(nodes))]
    return np.stack(each, axis=-1).astype(np.float32)


def _spread_out(pushes: Pushes) -> Pushes:
    """Pushes with different effects: the cheapest one in each cell of a grid of effects."""
    size = np.hypot(pushes.shift[:, 0], pushes.shift[:, 1]) + 50 * np.abs(pushes.turn)
    scaled = np.column_stack([pushes.shift, 50 * pushes.turn]) / size[:, None]
    cells = np.floor(np.column_stack([np.log(size), 1.7 * scaled]) / CELL).astype(np.int64)
    order = np.argsort(pushes.steps, kind="stable")
    _, first = np.unique(cells[order], axis=0, return_index=True)
    return pushes[np.sort(order[first])]


def _wrap(angle: Array) -> Array:
    return (angle + math.pi) % (2 * math.pi) - math.pi
