"""What a task is: all that recordings, episodes, policies and rollouts need to know about it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_ROUNDING = 1e-6  #: by which a limit in single precision may be off


class VectorSim(Protocol):
    """Several simulations that are stepped side by side."""

    @property
    def states(self) -> Array:
        """(n, columns of a state)."""

    @property
    def finished(self) -> NDArray[np.bool_]:
        """(n,), whether each episode is over before its time limit."""

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """One control step with actions (n, columns) in all simulations, or in the active ones."""

    def outcomes(self) -> dict[str, Array]:
        """The results of each episode so far, name -> (n,); with "mode", -1 for none."""


class Frame(Protocol):
    """A coordinate frame: what the network sees of a state, and how it writes down actions."""

    features: int  #: numbers for one observed state

    def observe(self, history: Array) -> Array:
        """(B, T, features) from states (B, T, columns)."""

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Actions (B, n, columns) of the world, in the frame that the last state defines."""

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""


@dataclass
class IdentityFrame:
    """The frame that changes nothing: states and actions as they are."""

    features: int

    def observe(self, history: Array) -> Array:
        """The states."""
        return history

    def to_frame(self, actions: Array, history: Array) -> Array:
        """The actions."""
        return actions

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The actions."""
        return actions


@dataclass(frozen=True)
class Demonstration:
    """One episode of an expert; row t of each array belongs to control step t.

    Attributes:
        state: (n, columns), before the action.
        action: (n, columns), what was done: intention plus noise, a multiple of the task's unit.
        intention: (n, columns), what the expert meant, a multiple of the task's unit.
        success: whether the goal was reached, in the mode that was chosen.
        mode: the mode that was chosen; None if the expert does not choose one in advance.
    """

    state: Array
    action: Array
    intention: Array
    success: bool
    mode: int | None = None


class Expert(Protocol):
    """A planned demonstrator."""

    def episode(self, seed: int, *, state: ArrayLike | None = None) -> Demonstration:
        """Demonstrates one episode.

        Args:
            seed: of the start, as in `env.reset(seed=seed)`, and of all choices.
            state: (columns,), where to start instead; then the seed is of the choices alone.
        """


@dataclass(frozen=True)
class Task:
    """A task for robots, as `cotlearn.robots.registry` lists it.

    Attributes:
        title: as files of demonstrations have it; in lower case the name of the task.
        environment: id of the gymnasium environment.
        entry_point: "module:class" of the environment.
        environment_options: keyword arguments of that class.
        vector_sim: makes the simulations that `env.reset(seed=...)` starts for some seeds.
        state: names of a state's columns. The first are where the tool is, in the space of actions.
        action: names of an action's columns.
        state_limits: (2, columns), the smallest and largest values of a state.
        action_limits: (2, columns), the same of an action; policies' actions are clipped to them.
        max_steps: control steps of an episode.
        frames: by name; the first is the default.
        score: the outcome by which policies are compared.
        modes: how many modes are told apart (outcome "mode").
        mode_steps: control steps after which the mode is known.
        demonstrations: the file of the course's demonstrations, in `data/`.
        expert: makes the demonstrator.
        state_units: what each column of a state is rounded to when it is stored.
        action_units: the same of an action, which is a multiple of it already.
        packages: whose versions a recording notes.
        thresholds: outcome -> (other outcome, value above which it is 1, else 0).
    """

    title: str
    environment: str
    entry_point: str
    vector_sim: Callable[[Sequence[int]], VectorSim]
    state: tuple[str, ...]
    action: tuple[str, ...]
    state_limits: Array
    action_limits: Array
    max_steps: int
    frames: Mapping[str, Frame]
    score: str
    modes: int
    mode_steps: int
    demonstrations: str
    expert: Callable[[], Expert]
    state_units: tuple[float, ...]
    action_units: tuple[float, ...]
    packages: tuple[str, ...]
    environment_options: Mapping[str, Any] = field(default_factory=dict)
    thresholds: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """As in `cotlearn bench NAME`."""
        return self.title.lower()

    @property
    def strictest(self) -> str:
        """The outcome with the highest threshold, or the score where there is none."""
        return next(reversed(tuple(self.thresholds)), self.score)


def chosen_start(options: Mapping[str, Any] | None, limits: ArrayLike) -> Array | None:
    """The state at which `env.reset(options={"state": ...})` shall start; None without options.

    Args:
        options: of `env.reset`.
        limits: (2, columns), the smallest and the largest values of a state.

    Raises:
        TypeError: the state is not made of real numbers.
        ValueError: there is anything else in `options`, or the state does not fit.
    """
    if not options:
        return None
    if set(options) != {"state"}:
        raise ValueError(f"options must be {{'state': ...}} or None, got {options!r}")
    return check_numbers(options["state"], limits, "state", shape=np.shape(limits)[1:])


def check_numbers(values: Any, limits: ArrayLike, name: str, *, shape: tuple[int, ...]) -> Array:
    """Returns actions or a state as float64 if they are finite, within limits and of this shape.

    Args:
        values: (..., columns).
        limits: (2, columns), the smallest and the largest values.
        name: of the argument.
        shape: that is expected.

    Raises:
        TypeError: they are not real numbers.
        ValueError: they have another shape, are not finite or outside the limits.
    """
    array = np.asarray(values)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name} must be real numbers, got {array.dtype}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array[~np.isfinite(array)].tolist()}")
    low, high = np.asarray(limits)
    if (array < low - _ROUNDING).any() or (array > high + _ROUNDING).any():
        raise ValueError(
            f"{name} must lie between {low.tolist()} and {high.tolist()}; got "
            f"values from {array.min():g} to {array.max():g}: clip them if that is what you mean"
        )
    return array
