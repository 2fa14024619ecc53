"""Value iteration: how many control steps from any pose of the T to the goal.

The T's pose relative to the goal is (x, y, angle): by how much its centre of gravity is off, in the
frame of the goal, and by how much it is turned. A push takes (x, y, angle) to
(x, y) + R(angle) shift, angle + turn. The value of a pose is

    V = min over pushes of (steps of the push + steps to get there + V after the push),

0 where the goal is reached, on a grid that is fine near the goal and coarse far from it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.experts.push_t.pushes import Pushes, library
from cotlearn.robots.push_t import GOAL, coverage
from cotlearn.robots.push_t.task import CENTRE_OF_GRAVITY
from cotlearn.robots.task import Array

Indices = NDArray[np.int64]
Single = NDArray[np.float32]

FARTHEST = 320.0  #: pixels
PLACES, BEND = 35, 4.2  #: nodes along x and y, and how much finer they lie near 0
TURNS, TURN_BEND = 45, 3.2
APPROACH = 10.0  #: steps from one push to the next, on average
ENOUGH = 0.957  #: a plan aims at a little more than the coverage that counts
CHOSEN = 400  #: pushes that the iteration looks at
SWEEPS = 20  #: at most; some 11 are enough

_MIDDLE = np.array(CENTRE_OF_GRAVITY)


@dataclass(frozen=True)
class Value:
    """Steps to the goal, interpolated on the grid.

    Attributes:
        table: (PLACES, PLACES, TURNS) for x, y and angle.
    """

    table: Array

    def __call__(self, relative: Array) -> Array:
        """(n,), the value of relative poses (n, 3)."""
        x, wx = _cell(relative[:, 0], FARTHEST, PLACES, BEND)
        y, wy = _cell(relative[:, 1], FARTHEST, PLACES, BEND)
        t, wt = _cell(_wrap(relative[:, 2]), math.pi, TURNS, TURN_BEND)
        total = np.zeros(len(relative))
        flat = self.table.ravel()
        for i, share_x in ((x, 1 - wx), (x + 1, wx)):
            for j, share_y in ((y, 1 - wy), (y + 1, wy)):
                row = (i * PLACES + j) * TURNS
                share = share_x * share_y
                total += share * ((1 - wt) * flat[row + t] + wt * flat[row + t + 1])
        return total


def relative_pose(pose: Array) -> Array:
    """(3,), the pose of the T relative to the goal."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    cos_goal, sin_goal = math.cos(GOAL[2]), math.sin(GOAL[2])
    dx = pose[0] - sin * _MIDDLE[1] - (GOAL[0] - sin_goal * _MIDDLE[1])
    dy = pose[1] + cos * _MIDDLE[1] - (GOAL[1] + cos_goal * _MIDDLE[1])
    x, y = cos_goal * dx + sin_goal * dy, cos_goal * dy - sin_goal * dx
    return np.array([x, y, float(_wrap(np.array(pose[2] - GOAL[2])))])


def world_pose(relative: Array) -> Array:
    """(n, 3), the poses in the world of relative poses (n, 3): undoes `relative_pose`."""
    angle = relative[:, 2] + GOAL[2]
    cos_goal, sin_goal = math.cos(GOAL[2]), math.sin(GOAL[2])
    x = GOAL[0] + cos_goal * relative[:, 0] - sin_goal * (relative[:, 1] + _MIDDLE[1])
    y = GOAL[1] + sin_goal * relative[:, 0] + cos_goal * (relative[:, 1] + _MIDDLE[1])
    return np.stack([x + np.sin(angle) * _MIDDLE[1], y - np.cos(angle) * _MIDDLE[1], angle], axis=1)


def after(relative: Array, pushes: Pushes) -> Array:
    """(m, 3), the relative poses after each of m pushes at the relative pose (3,)."""
    cos, sin = math.cos(relative[2]), math.sin(relative[2])
    x = relative[0] + cos * pushes.shift[:, 0] - sin * pushes.shift[:, 1]
    y = relative[1] + sin * pushes.shift[:, 0] + cos * pushes.shift[:, 1]
    return np.stack([x, y, relative[2] + pushes.turn], axis=1)


def reached(relative: Array) -> NDArray[np.bool_]:
    """(n,), where relative poses (n, 3) cover the goal by more than `ENOUGH`."""
    angle = _wrap(relative[:, 2])
    near = (np.abs(relative[:, :2]).max(axis=1) < 8.0) & (np.abs(angle) < 0.15)
    found = np.zeros(len(relative), dtype=bool)
    found[near] = coverage(world_pose(relative[near])) > ENOUGH
    return found


@functools.lru_cache(maxsize=1)
def value() -> Value:
    """The value of every pose, by value iteration over a part of the library (6 s)."""
    pushes = _spread_out(library(), CHOSEN)
    places = _nodes(FARTHEST, PLACES, BEND)
    turns = _nodes(math.pi, TURNS, TURN_BEND)
    grid = np.stack(np.meshgrid(places, places, turns, indexing="ij"), axis=-1)
    at_goal = reached(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    table = np.hypot(grid[..., 0], grid[..., 1]) / 8 + np.abs(grid[..., 2]) * 10 + APPROACH
    table[at_goal] = 0.0
    table = table.astype(np.float32)  # in single precision it is twice as fast
    moves = [_moves(angle, pushes, places) for angle in turns]
    cost = (pushes.steps + APPROACH).astype(np.float32)[:, None, None]
    for _ in range(SWEEPS):
        best = np.stack([_improved(table, move, cost) for move in moves], axis=2)
        best[at_goal] = 0.0
        change = float(np.abs(best - table).max())
        table = best
        if change < 0.05:
            break
    return Value(table.astype(np.float64))


Move = tuple[Indices, Array, Indices, Array, Indices, Array, Indices]


def _moves(angle: float, pushes: Pushes, places: Array) -> Move:
    """Where each push leads from all places, at one angle; x, y and angle go separately."""
    zero = after(np.array([0.0, 0.0, angle]), pushes)
    x, wx = _cell(places + zero[:, 0, None], FARTHEST, PLACES, BEND)  # (m, PLACES)
    y, wy = _cell(places + zero[:, 1, None], FARTHEST, PLACES, BEND)
    t, wt = _cell(_wrap(zero[:, 2]), math.pi, TURNS, TURN_BEND)
    near = np.abs(_wrap(zero[:, 2])) < 0.15
    m, i, j = np.nonzero(
        near[:, None, None]
        & (np.abs(places + zero[:, 0, None]) < 8.0)[:, :, None]
        & (np.abs(places + zero[:, 1, None]) < 8.0)[:, None, :]
    )
    relative = np.stack([places[i] + zero[m, 0], places[j] + zero[m, 1], zero[m, 2]], axis=1)
    return x, wx, y, wy, t, wt, np.stack([m, i, j], axis=1)[reached(relative)]


def _improved(table: Single, move: Move, cost: Single) -> Single:
    """(PLACES, PLACES), the least cost over the pushes, at one angle."""
    x, wx, y, wy, t, wt, done = move
    share = wt.astype(np.float32)[:, None, None]
    by_turn = np.ascontiguousarray(table.transpose(2, 0, 1))
    slab = by_turn[t] * (1 - share) + by_turn[t + 1] * share
    share = wx.astype(np.float32)[:, :, None]
    rows = np.arange(len(x))[:, None]
    slab = slab[rows, x] * (1 - share) + slab[rows, x + 1] * share
    share = wy.astype(np.float32)[:, None, :]
    low = np.take_along_axis(slab, y[:, None, :], axis=2)
    high = np.take_along_axis(slab, y[:, None, :] + 1, axis=2)
    future = low * (1 - share) + high * share
    future[tuple(done.T)] = 0.0
    return (future + cost).min(axis=0)


def _spread_out(pushes: Pushes, count: int) -> Pushes:
    """Pushes that differ in effect: the cheapest one of each cell of a grid of effects."""
    size = np.hypot(pushes.shift[:, 0], pushes.shift[:, 1]) + 50 * np.abs(pushes.turn)
    scaled = np.column_stack([pushes.shift, 50 * pushes.turn]) / np.maximum(size, 1e-9)[:, None]
    effect = np.column_stack([np.log(size), 1.7 * scaled])
    low, high = 0.05, 2.0
    for _ in range(30):  # the width of a cell that leaves about `count` pushes
        width = (low + high) / 2
        cells = np.floor(effect / width).astype(np.int64)
        order = np.argsort(pushes.steps, kind="stable")
        _, first = np.unique(cells[order], axis=0, return_index=True)
        if len(first) > count:
            low = width
        else:
            high = width
    return pushes[np.sort(order[first])]


def _nodes(farthest: float, count: int, bend: float) -> Array:
    return farthest / math.sinh(bend) * np.sinh(bend * np.linspace(-1, 1, count))


def _cell(
    value: Array, farthest: float, count: int, bend: float
) -> tuple[NDArray[np.int64], Array]:
    """The node below a value, and the share of the next one."""
    place = np.arcsinh(value * (math.sinh(bend) / farthest)) / bend
    place = np.clip((place + 1) / 2 * (count - 1), 0.0, count - 1.001)
    node = place.astype(np.int64)
    nodes = _nodes(farthest, count, bend)
    share = (value - nodes[node]) / (nodes[node + 1] - nodes[node])
    return node, np.clip(share, 0.0, 1.0)


def _wrap(angle: Array) -> Array:
    return (angle + math.pi) % (2 * math.pi) - math.pi
