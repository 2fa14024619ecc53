"""Push-T for rollouts: many worlds, what came of each, and on which side it began."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.push_t.geometry import nearest_side
from cotlearn.robots.push_t.simulation import Simulations, random_state
from cotlearn.robots.push_t.task import SUCCESS
from cotlearn.robots.task import Array

MOVED = 1e-6  #: pixels by which a T that is pushed moves at least


class PushTWorlds(Simulations):
    """The worlds that `env.reset(seed=...)` would start for these seeds.

    Args:
        seeds: (n,).
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        super().__init__([random_state(np.random.default_rng(seed)) for seed in seeds])
        self._best = self.coverage
        self._mode = np.full(len(self.worlds), -1.0)

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Steps all worlds, or those that are `active`; see `Simulations.step`."""
        before = self.states
        super().step(actions, active=active)
        now = self.states
        self._best = np.maximum(self._best, self.coverage)
        pushed = np.abs(now[:, 2:4] - before[:, 2:4]).max(axis=1) > MOVED
        first = np.flatnonzero(pushed & (self._mode < 0))
        if len(first):
            self._mode[first] = nearest_side(now[first, :2], now[first, 2:])

    @property
    def finished(self) -> NDArray[np.bool_]:
        """(n,), whether the T has once covered more than 0.95 of the goal."""
        return self._best > SUCCESS

    def outcomes(self) -> dict[str, Array]:
        """Name -> (n,).

        - "coverage", the best at any time: the score of Diffusion Policy is min(1, it / 0.95);
        - "last", the coverage now;
        - "mode", the side of the T (0 to 7, round its outline) that was pushed first, or -1.
        """
        return {"coverage": self._best.copy(), "last": self.coverage, "mode": self._mode.copy()}
