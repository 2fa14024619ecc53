"""A library of straight pushes and their effects on the T.

Without friction and velocity, the effect of a push in the frame of the T does not depend on the
T's pose, so each push is simulated once. Pushes on the left are mirror images of those on the
right.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.constants import AGENT_RADIUS, CENTRE_OF_GRAVITY, OUTLINE
from cotlearn.robots.push_t.expert.route import distance
from cotlearn.robots.push_t.geometry import corners
from cotlearn.robots.push_t.simulation import Simulation
from cotlearn.robots.task import Array

GAP = 4.0  #: between agent and T before a push, pixels
SPACING = 4.0  #: between starts along a side of the T, pixels
ANGLES = np.radians([-50.0, -32.0, -16.0, 0.0, 16.0, 32.0, 50.0])  #: from the side's normal
LENGTHS = (6.0, 8.0, 10.0, 13.0, 16.0, 20.0, 26.0, 34.0, 44.0, 56.0, 72.0, 92.0, 120.0)
AHEAD = 28.0  #: the target runs this far ahead of the agent while it pushes, pixels
CLOSE = 1.5  #: distance from the end at which a push is complete, pixels
MOST_STEPS = 30

MIDDLE = np.array(CENTRE_OF_GRAVITY)  #: of the T, in its frame


@dataclass(frozen=True)
class Pushes:
    """m pushes in the frame of the T.

    Attributes:
        start: (m, 2), where the agent is at rest before the push.
        direction: (m, 2), unit vectors.
        length: (m,), from the start to the end of the push.
        shift: (m, 2), displacement of the T's centre of gravity, in the frame before the push.
        turn: (m,), rotation of the T, radians.
        steps: (m,), control steps.
        side: (m,), side of the outline that is pushed, 0 to 7.
    """

    start: Array
    direction: Array
    length: Array
    shift: Array
    turn: Array
    steps: Array
    side: NDArray[np.int64]

    def __getitem__(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Pushes:
        return Pushes(*(getattr(self, name)[rows] for name in self.__dataclass_fields__))


def push_targets(world: Simulation, start: Array, along: Array, length: float) -> Iterator[Array]:
    """Yield the agent's target for each step of a push until it is complete, in the world frame."""
    for _ in range(MOST_STEPS):
        done = float((np.array(world.state[:2]) - start) @ along)
        if done > length - CLOSE:
            return
        yield start + min(done + AHEAD, length) * along


@functools.lru_cache(maxsize=1)
def library() -> Pushes:
    """All pushes, from simulations (2 s)."""
    rows = []
    for start, normal, side in _starts():
        for angle in ANGLES:
            direction = rotate(normal, math.cos(angle), math.sin(angle))
            for length in LENGTHS:
                shift, turn, steps = _simulate(start, direction, length)
                if abs(shift).sum() + 40 * abs(turn) > 0.3:
                    rows.append((*start, *direction, length, *shift, turn, steps, side))
    table = np.array(rows)
    mirrored = table.copy()
    mirrored[:, [0, 2, 5, 7]] *= -1
    mirrored[:, 9] = -table[:, 9] % 8  # sides are numbered around the T, from the bar's edge
    table = np.concatenate([table, mirrored[table[:, 0] > 0]])
    start, direction, shift = table[:, 0:2], table[:, 2:4], table[:, 5:7]
    length, turn, steps, side = table[:, [4, 7, 8, 9]].T
    return Pushes(start, direction, length, shift, turn, steps, side.astype(np.int64))


def _starts() -> list[tuple[Array, Array, int]]:
    """Starts beside the right half of the T, with the inward normal and number of the side."""
    found = []
    outline = np.array(OUTLINE)
    for side, (a, b) in enumerate(zip(outline, np.roll(outline, -1, axis=0), strict=True)):
        span = float(np.linalg.norm(b - a))
        along = (b - a) / span
        normal = np.array([-along[1], along[0]])  # to the inside
        count = round(span / SPACING)
        for place in (np.arange(count) + 0.5) * span / count:
            start = a + place * along - (AGENT_RADIUS + GAP) * normal
            if start[0] >= 0 and distance(start[None])[0] > AGENT_RADIUS + GAP - 0.01:
                found.append((start, normal, side))
    return found


def _simulate(start: Array, direction: Array, length: float) -> tuple[Array, float, int]:
    here = np.array([256.0, 256.0])
    world = Simulation([*(here + start), *here, 0.0])
    steps = 0
    for target in push_targets(world, here + start, direction, length):
        world.step(*target.tolist())
        steps += 1
    pose = world.state[2:]
    return corners(pose, [MIDDLE])[0] - (here + MIDDLE), pose[2], steps
