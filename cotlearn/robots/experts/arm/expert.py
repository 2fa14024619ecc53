"""The demonstrator of the arm: any way round the pillars is as good as any other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.arm import task
from cotlearn.robots.arm.simulation import ArmWorlds, random_start
from cotlearn.robots.experts.arm.path import CLEARANCE, clearance, minimum_jerk, via_points
from cotlearn.validation import check_choice, check_number

Array = NDArray[np.float64]

NOISE = 0.005  #: standard deviation of what is added to each coordinate of an action, metres
UNIT = 2.0**-14  #: actions are multiples of this, so that they can be stored exactly, metres
_HURRY = 0.2  #: logarithm of how much slower or faster than on average a part of a path is, at most
_TRIES = 50  #: paths that are drawn to find one that is clear of the pillars


@dataclass(frozen=True)
class Episode:
    """A demonstration; row t of the first three belongs to control step t.

    Attributes:
        state: (40, columns), before the action.
        action: (40, 3), what was done: the intention, plus noise, as a multiple of 2⁻¹⁴ m.
        intention: (40, 3), what the expert meant, as a multiple of 2⁻¹⁴ m.
        mode: number of the way round in `task.WAYS`.
        success: whether the goal was reached that way and nothing was touched.
    """

    state: Array
    action: Array
    intention: Array
    mode: int
    success: bool


class ArmExpert:
    """Draws a way round, via points and a minimum-jerk path, and follows it step by step.

    Its targets do not depend on where the tip really is. So after noise has pushed the tip aside,
    the next intention leads it back: the data contain recoveries.

    Args:
        kind: "ring" or "avoid".
        noise: standard deviation in metres of what is added to the actions.
    """

    def __init__(self, kind: str, *, noise: float = NOISE) -> None:
        self.kind = check_choice(kind, "kind", task.KINDS)
        self.noise = check_number(noise, "noise")

    def episode(
        self, seed: int, *, state: ArrayLike | None = None, way: int | None = None
    ) -> Episode:
        """Demonstrates one episode.

        Args:
            seed: of the start, as in `env.reset(seed=seed)`, and of all choices.
            state: (columns,), where to start instead; then the seed is of the choices alone.
            way: the way round to take; by chance, all with the same probability, if None.

        Raises:
            ValueError: there is no such way, or the state cannot be.
        """
        generator = np.random.default_rng([seed, 1])
        ways = len(task.WAYS[self.kind])
        drawn = int(generator.integers(ways))
        if way is not None and not 0 <= way < ways:
            raise ValueError(f"way must be from 0 to {ways - 1}, got {way}")
        mode = drawn if way is None else way
        if state is None:
            state = random_start(np.random.default_rng(seed), self.kind)
        worlds = ArmWorlds.at(np.asarray(state, dtype=np.float64)[None], self.kind)
        path = self.path(worlds.states[0], mode, generator)
        states, actions, intentions = [], [], []
        for target in path:
            intention = np.rint(target / UNIT) * UNIT
            noise = self.noise * generator.standard_normal(3)
            action = np.rint(np.clip(intention + noise, task.LOW, task.HIGH) / UNIT) * UNIT
            states.append(worlds.states[0])
            actions.append(action)
            intentions.append(intention)
            if not worlds.done[0]:
                worlds.step(action[None])
        success = int(worlds.outcomes()["mode"][0]) == mode
        return Episode(np.array(states), np.array(actions), np.array(intentions), mode, success)

    def path(self, state: Array, way: int, generator: np.random.Generator) -> Array:
        """Draws the targets (40, 3) of an undisturbed episode.

        Of the paths that it draws, it takes the first that is clear of the pillars, or the one
        that keeps farthest from them.
        """
        best, room = None, -np.inf
        fine = np.linspace(0, 1, 10 * task.MAX_STEPS + 1)
        for _ in range(_TRIES):
            via = via_points(state, way, self.kind, generator)
            points = np.vstack([state[task.TIP], via, state[task.GOAL]])
            spans = np.linalg.norm(np.diff(points, axis=0), axis=1)
            spans *= np.exp(generator.uniform(-_HURRY, _HURRY, len(spans)))
            times = np.concatenate([[0.0], spans.cumsum() / spans.sum()])
            path = minimum_jerk(points, times, fine)
            here = float(clearance(path, task.pillars(state)).min())
            if here > room:
                best, room = path, here
            if here >= CLEARANCE:
                break
        assert best is not None
        return best[10::10]
