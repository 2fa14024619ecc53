"""What policies, episodes and rollouts need to know about a task, and nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


class Worlds(Protocol):
    """Several worlds that are stepped side by side."""

    @property
    def states(self) -> Array:
        """(n, columns of a state)."""
        ...

    @property
    def finished(self) -> NDArray[np.bool_]:
        """(n,), whether the episode of each world is over before its time limit."""
        ...

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """One control step with actions (n, columns) of all worlds, or of the active ones."""
        ...

    def outcomes(self) -> dict[str, Array]:
        """What each episode came to until now, name -> (n,); with "mode", -1 for none."""
        ...


class Frame(Protocol):
    """A way to write down states and actions: what the network gets to see, and says."""

    features: int  #: numbers for one observed state

    def observe(self, history: Array) -> Array:
        """(B, T, features) from states (B, T, columns)."""
        ...

    def into(self, actions: Array, history: Array) -> Array:
        """Actions (B, n, columns) of the world, as seen in the frame of the last state."""
        ...

    def out(self, actions: Array, history: Array) -> Array:
        """The inverse of `into`."""
        ...


class World:
    """The frame that changes nothing: states and actions as they are."""

    def __init__(self, features: int) -> None:
        self.features = features

    def observe(self, history: Array) -> Array:
        """The states."""
        return history

    def into(self, actions: Array, history: Array) -> Array:
        """The actions."""
        return actions

    def out(self, actions: Array, history: Array) -> Array:
        """The actions."""
        return actions


@dataclass(frozen=True)
class Task:
    """A task for robots.

    Attributes:
        name: as in `cotlearn bench NAME`.
        state: names of a state's columns. The first are where the tool is, in the space of actions.
        action: names of an action's columns.
        state_limits: (2, columns), the smallest and largest values of a state.
        action_limits: (2, columns), the same of an action, which policies are cut to.
        max_steps: control steps of an episode.
        frames: by name; the first is the default.
        worlds: makes the worlds of some seeds.
        score: the outcome that decides.
        thresholds: outcome -> (other outcome, value above which it is 1, else 0).
        modes: how many ways of doing it are told apart (outcome "mode").
        mode_steps: control steps after which the mode is known.
    """

    name: str
    state: tuple[str, ...]
    action: tuple[str, ...]
    state_limits: Array
    action_limits: Array
    max_steps: int
    frames: Mapping[str, Frame]
    worlds: Callable[[Sequence[int]], Worlds]
    score: str
    modes: int
    mode_steps: int
    thresholds: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def check_actions(self, actions: Any, name: str = "actions") -> Array:
        """Returns actions (..., columns) as float64 if they are finite numbers within the limits.

        Raises:
            TypeError: they are not real numbers.
            ValueError: they are not finite or outside the limits.
        """
        array = np.asarray(actions)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"{name} must be real numbers, got {array.dtype}")
        array = array.astype(np.float64)
        if not np.isfinite(array).all():
            raise ValueError(f"{name} must be finite, got {array[~np.isfinite(array)].tolist()}")
        low, high = self.action_limits
        if (array < low).any() or (array > high).any():
            span = ", ".join(
                f"{column} in [{a:g}, {b:g}]"
                for column, a, b in zip(self.action, low, high, strict=True)
            )
            raise ValueError(
                f"{name} must lie within {span}; got values from {array.min():g} to "
                f"{array.max():g}: clip them if that is what you mean"
            )
        return array
