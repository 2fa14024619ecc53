"""The demonstrator of Push-T: it plans a push, goes around the T, pushes, and plans again."""

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.constants import (
    AGENT_RADIUS,
    MAX_STEPS,
    PIXEL,
    SIZE,
    SUCCESS,
    WALL_RADIUS,
    WALLS,
)
from cotlearn.robots.push_t.expert import plan, route
from cotlearn.robots.push_t.expert.pushes import library, push_targets
from cotlearn.robots.push_t.geometry import corners
from cotlearn.robots.push_t.simulation import Simulation, random_state
from cotlearn.robots.task import Array, Demonstration

#: Softmax temperature of the choice among sides of the T, in steps.
TEMPERATURE = 2.0
WITHIN = 0.25  #: temperature among pushes on one side, relative to `TEMPERATURE`
SLACK = 3.0  #: options are never chosen that cost this many temperatures more than the best
NOISE = 5.0  #: standard deviation of the noise added to each coordinate of an action, pixels

SPEED = 24.0  #: approximate speed of the agent between pushes, pixels per step
_AHEAD = (48.0, 36.0, 24.0, 16.0, 8.0)  #: lookahead distances; the first clear one is used
_GRAIN = 4.0  #: distance between points of a path, pixels
_TOUCH = AGENT_RADIUS + 1.5
_INSIDE = WALLS[0] + WALL_RADIUS, WALLS[1] - WALL_RADIUS  #: where walls leave room for the T


@dataclass(frozen=True)
class Options:
    """The m pushes among which the expert chooses in a state.

    Attributes:
        rows: (m,), indices of the pushes in the library.
        cost: (m,), steps to the goal: approaching, pushing and afterwards.
        probability: (m,), probability of choosing each push.
        found: the paths to the starts of the pushes, for `Routes.way`.
    """

    rows: NDArray[np.int64]
    cost: Array
    probability: Array
    found: route.Found


class PushTExpert:
    """Plans with the value function of `plan` and chooses at random among nearly optimal pushes.

    Creating the first expert takes about 8 s for the library and the plan, which are cached.
    """

    def __init__(self) -> None:
        self.pushes = library()
        self.value = plan.value()
        starts, self._place = np.unique(self.pushes.start.round(6), axis=0, return_inverse=True)
        self._routes = route.Routes(starts)

    def episode(self, seed: int, *, state: ArrayLike | None = None) -> Demonstration:
        """Demonstrates one episode; see `cotlearn.robots.task.Expert`.

        The angle of the T in its states is not reduced to one turn.
        """
        world = Simulation(random_state(np.random.default_rng(seed)) if state is None else state)
        generator = np.random.default_rng([seed, 1])
        rows = []
        for target in self._targets(world, generator):
            intention = _representable(target)
            action = _representable(intention + NOISE * generator.standard_normal(2))
            rows.append((world.state, action, intention))
            world.step(*action.tolist())
            if world.coverage > SUCCESS or len(rows) == MAX_STEPS:
                break
        states, actions, intentions = map(np.array, zip(*rows, strict=True))
        return Demonstration(states, actions, intentions, world.coverage > SUCCESS)

    def first_sides(self, state: Array) -> Array:
        """The probability (8,) that the next push is on each side of the T (the expert's mode)."""
        options = self.options(state)
        return np.bincount(self.pushes.side[options.rows], options.probability, 8).astype(float)

    def options(self, state: Array) -> Options:
        """The pushes that may be chosen in a state (5,), with their probabilities."""
        pose = state[2:]
        future = plan.after(plan.relative_pose(pose), self.pushes)
        value = np.where(plan.reached(future), 0.0, self.value(future))
        turns = corners(pose, route.TURNS)
        agent = route.step_back(_to_body(state[:2], pose))
        usable = np.all((turns > 0) & (turns < SIZE), axis=1)
        lengths, found = self._routes.lengths(agent, usable)
        if np.isinf(lengths).all():  # shut in between the T and a wall: straight through
            lengths = np.hypot(*(self._routes.places - agent).T)
        cost = lengths[self._place] / SPEED + self.pushes.steps + value
        order = np.argsort(cost, kind="stable")
        near = order[cost[order] < cost[order[0]] + 25.0]
        possible = near[self._possible(near, pose, future[near])]
        near = possible if len(possible) else near[:1]
        probability = _softmax_by_side(cost[near], self.pushes.side[near])
        kept = probability > 0
        return Options(near[kept], cost[near][kept], probability[kept], found)

    def _possible(self, rows: NDArray[np.int64], pose: Array, future: Array) -> NDArray[np.bool_]:
        """Whether a push keeps the agent in the world and the T clear of the walls, (m,)."""
        pushes = self.pushes[rows]
        ends = np.stack([pushes.start, pushes.start + pushes.length[:, None] * pushes.direction])
        places = corners(pose, ends.reshape(-1, 2)).reshape(ends.shape)
        agent = ((places > 4) & (places < SIZE - 4)).all(axis=(0, 2))
        out_now = _out_of_walls(pose[None])[0]
        return agent & (_out_of_walls(plan.world_pose(future)) <= max(out_now, 0.0))

    def _targets(self, world: Simulation, generator: np.random.Generator) -> Iterator[Array]:
        while True:
            state = np.array(world.state)
            options = self.options(state)
            row = int(generator.choice(options.rows, p=options.probability))
            pose = state[2:]
            start = self.pushes.start[row]
            agent = _to_body(state[:2], pose)
            turns = self._routes.way(int(self._place[row]), options.found)
            way = np.vstack([agent, route.step_back(agent), turns, start])
            length = float(self.pushes.length[row])
            arrived = yield from _travel(world, corners(pose, way), min(max(0.15 * length, 3), 6))
            if arrived:
                direction = corners((0, 0, pose[2]), self.pushes.direction[row][None])[0]
                yield from push_targets(world, corners(pose, start[None])[0], direction, length)


def _softmax_by_side(cost: Array, side: NDArray[np.int64]) -> Array:
    """Probabilities of choosing first a side of the T by its best push, then a push on that side.

    Demonstrations differ by side, but hardly among the many pushes on one side, whose number must
    not outweigh another side.
    """
    best = np.full(8, np.inf)
    np.minimum.at(best, side, cost)
    of_side = _softmax(best, TEMPERATURE)
    probability = np.zeros(len(cost))
    for number in np.flatnonzero(of_side):
        rows = side == number
        probability[rows] = of_side[number] * _softmax(cost[rows], WITHIN * TEMPERATURE)
    return probability / probability.sum()


def _softmax(cost: Array, temperature: float) -> Array:
    extra = (cost - cost.min()) / temperature
    weight = np.where(extra <= SLACK, np.exp(-extra), 0.0)
    return weight / weight.sum()


def _travel(world: Simulation, way: Array, tolerance: float) -> Generator[Array, None, bool]:
    """Pure pursuit along a path in the world; returns whether it reached the end undisturbed."""
    before = np.array(world.state[2:])
    points = _fine(way)
    here = 0
    for _ in range(80):
        state = np.array(world.state)
        pose, agent = state[2:], state[:2]
        if np.abs(pose - before)[:2].max() > 2 or abs(pose[2] - before[2]) > 0.03:
            return False
        window = points[here : here + 16]
        here += int(((window - agent) ** 2).sum(axis=1).argmin())
        if np.hypot(*(agent - points[-1])) < tolerance:
            return True
        ahead = np.minimum(here + (np.array(_AHEAD) / _GRAIN).astype(int), len(points) - 1)
        candidates = _to_body(points[ahead], pose)
        body = _to_body(agent, pose)
        needed = min(_TOUCH, route.distance(body[None])[0] - 0.5)
        clear = route.clearance(np.tile(body, (len(ahead), 1)), candidates) >= needed
        yield points[ahead[int(clear.argmax()) if clear.any() else -1]]
    return False


def _fine(way: Array) -> Array:
    """Points along a path, `_GRAIN` apart."""
    counts = np.ceil(np.hypot(*np.diff(way, axis=0).T) / _GRAIN).clip(1)
    legs = zip(way[:-1], way[1:], counts, strict=True)
    pieces = [a + (b - a) * (np.arange(1, n + 1) / n)[:, None] for a, b, n in legs]
    return np.concatenate([way[:1], *pieces])


def _to_body(points: Array, pose: Array) -> Array:
    return rotate(points - pose[:2], math.cos(pose[2]), -math.sin(pose[2]))


def _out_of_walls(pose: Array) -> Array:
    """How far (n,) the T reaches into a wall, in pixels; negative if it is clear of the walls."""
    points = corners(pose)
    return np.maximum(_INSIDE[0] - points, points - _INSIDE[1]).max(axis=(1, 2))


def _representable(target: Array) -> Array:
    return np.rint(np.clip(target, 0.0, SIZE) / PIXEL) * PIXEL
