"""The demonstrator of the arm: it chooses all modes with equal probability."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from cotlearn.robots.arm import constants
from cotlearn.robots.arm.constants import UNIT
from cotlearn.robots.arm.expert.path import CLEARANCE, clearance, minimum_jerk, via_points
from cotlearn.robots.arm.simulation import ArmVectorSim, random_start
from cotlearn.robots.task import Array, Demonstration

NOISE = 0.005  #: standard deviation of the noise added to each coordinate of an action, metres
_HURRY = 0.2  #: largest absolute logarithm of a path segment's relative duration
_TRIES = 50  #: most paths that are drawn to find one that is clear of the pillars


@dataclass(frozen=True)
class ArmExpert:
    """Draws a mode, via points and a minimum-jerk path, and follows it step by step.

    Its targets do not depend on the actual position of the tip. So after noise has pushed the tip
    aside, the next intention leads it back, and the data contain recoveries.

    Attributes:
        kind: "ring" or "avoid".
    """

    kind: str

    def episode(self, seed: int, *, state: ArrayLike | None = None) -> Demonstration:
        """Demonstrates one episode of 40 steps; see `cotlearn.robots.task.Expert`."""
        generator = np.random.default_rng([seed, 1])
        mode = int(generator.integers(len(constants.MODES[self.kind])))
        if state is None:
            state = random_start(np.random.default_rng(seed), self.kind)
        sim = ArmVectorSim(np.asarray(state)[None], self.kind)
        rows = []
        for target in self.path(sim.states[0], mode, generator):
            intention = np.rint(target / UNIT) * UNIT
            noise = NOISE * generator.standard_normal(3)
            action = (
                np.rint(np.clip(intention + noise, constants.LOW, constants.HIGH) / UNIT) * UNIT
            )
            rows.append((sim.states[0], action, intention))
            sim.step(action[None])
        states, actions, intentions = map(np.array, zip(*rows, strict=True))
        success = int(sim.outcomes()["mode"][0]) == mode
        return Demonstration(states, actions, intentions, success, mode)

    def path(self, state: Array, mode: int, generator: np.random.Generator) -> Array:
        """Draws the targets (40, 3) of an episode without noise.

        It returns the first drawn path that is clear of the pillars, or after 50 draws the path
        with the largest clearance.
        """
        best, room = np.empty((0, 3)), -np.inf
        fine = np.linspace(0, 1, 10 * constants.MAX_STEPS + 1)
        for _ in range(_TRIES):
            via = via_points(state, mode, self.kind, generator)
            points = np.vstack([state[constants.TIP], via, state[constants.GOAL]])
            spans = np.linalg.norm(np.diff(points, axis=0), axis=1)
            spans *= np.exp(generator.uniform(-_HURRY, _HURRY, len(spans)))
            times = np.concatenate([[0.0], spans.cumsum() / spans.sum()])
            path = minimum_jerk(points, times, fine)
            here = float(clearance(path, constants.pillars(state)).min())
            if here > room:
                best, room = path, here
            if here >= CLEARANCE:
                break
        return best[10::10]
