"""`Task` and its parts: what recordings, episodes, policies and rollouts need to know."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.layout import LeRobotLayout
from cotlearn.validation import check_real

Array = NDArray[np.float64]

_ROUNDING = 1e-6  #: tolerance of limits, for rounding in single precision


class VectorSim(Protocol):
    """Several simulations that are stepped in parallel."""

    @property
    def states(self) -> Array:
        """The current states, (n, columns)."""

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Whether each episode has ended before its time limit, (n,)."""

    def step(self, actions: ArrayLike, *, active: NDArray[np.bool_] | None = None) -> None:
        """Take a control step with actions (n, columns) in all simulations, or the active ones."""

    def outcomes(self) -> dict[str, Array]:
        """The results of each episode so far, name -> (n,), including "mode" (-1: no mode)."""


@dataclass
class Frame:
    """A coordinate frame in which the network observes states and predicts actions.

    This one is the world's, which changes neither states nor actions; others override its methods.

    Attributes:
        features: number of features of one observed state.
    """

    features: int

    def observe(self, history: Array) -> Array:
        """Convert states (B, T, columns) to features (B, T, features)."""
        return history

    def to_frame(self, actions: Array, history: Array) -> Array:
        """Transform world actions (B, n, columns) to the frame given by the last state."""
        return actions

    def from_frame(self, actions: Array, history: Array) -> Array:
        """The inverse of `to_frame`."""
        return actions


@dataclass(frozen=True)
class Demonstration:
    """One episode of an expert; row t of each array belongs to control step t.

    Attributes:
        state: (n, columns), states before each action.
        action: (n, columns), executed actions: intention plus noise, multiples of the task's unit.
        intention: (n, columns), the expert's actions before noise, multiples of the task's unit.
        success: whether the goal was reached in the chosen mode.
        mode: the chosen mode; None if the expert does not choose one in advance.
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
            seed: of the start, as in `env.reset(seed=seed)`, and of all random choices.
            state: (columns,), a start that replaces the seed's; the seed then sets only choices.
        """


@dataclass(frozen=True)
class Task:
    """A robot task, as listed in `cotlearn.robots.registry`.

    Attributes:
        title: title in files of demonstrations; in lower case, the name of the task.
        environment: id of the gymnasium environment.
        entry_point: "module:class" of the environment.
        environment_options: keyword arguments of that class.
        vector_sim: maps seeds to the simulations that `env.reset(seed=...)` would start.
        state: names of a state's columns; the first are the position of the tool, in the space of
            actions.
        action: names of an action's columns.
        state_limits: (2, columns), smallest and largest values of a state.
        action_limits: (2, columns), smallest and largest values of an action; policies' actions
            are clipped to them.
        max_steps: time limit of an episode in control steps.
        frames: name -> frame; the first is the default.
        score: the outcome by which policies are compared.
        modes: number of modes (values of the outcome "mode").
        mode_steps: control steps after which the mode is known.
        expert: creates the demonstrator.
        state_units: unit to which each column of a state is rounded in files, whose numbers have 16
            bits: values lie within 32,767 units. Angles in units of 2 pi / 65536 wrap around.
        action_units: unit of each column of an action; actions are multiples of it.
        packages: packages whose versions a recording stores.
        thresholds: outcome -> (other outcome, value above which the outcome is 1, else 0).
        capped: outcome -> (other outcome, value at which the outcome reaches 1); below, their
            ratio.
        early_steps: control steps after which rollouts note the score as well, as
            `<score>_<steps>`; None: they do not.
        demonstrations: file name of the course's demonstrations in `data/`; empty: none ship.
        lerobot: how LeRobot's data sets show its states; None: they are not read.
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
    expert: Callable[[], Expert]
    state_units: tuple[float, ...]
    action_units: tuple[float, ...]
    packages: tuple[str, ...]
    environment_options: Mapping[str, Any] = field(default_factory=dict)
    thresholds: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    capped: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    early_steps: int | None = None
    demonstrations: str = ""
    lerobot: LeRobotLayout | None = None

    @property
    def name(self) -> str:
        """The task's name on the command line: the title in lower case."""
        return self.title.lower()

    @property
    def strictest(self) -> str:
        """The last outcome in `thresholds`, which has the highest threshold; else the score."""
        return next(reversed(tuple(self.thresholds)), self.score)


def check_started(simulation: Any) -> Any:
    """Return the simulation of an environment; None, before the first reset, is refused.

    Raises:
        RuntimeError: there is none.
    """
    if simulation is None:
        raise RuntimeError("the environment has no state yet: call env.reset() first")
    return simulation


def chosen_start(options: Mapping[str, Any] | None, limits: ArrayLike) -> Array | None:
    """Return the start state in `env.reset(options={"state": ...})`; None without options.

    Args:
        options: the options of `env.reset`.
        limits: (2, columns), smallest and largest values of a state.

    Raises:
        TypeError: the state does not hold real numbers.
        ValueError: `options` has another key, or the state has a wrong shape or is out of range.
    """
    if not options:
        return None
    if set(options) != {"state"}:
        raise ValueError(f"options must be {{'state': ...}} or None, got {options!r}")
    return check_numbers(options["state"], limits, "state", shape=np.shape(limits)[1:])


def check_numbers(values: Any, limits: ArrayLike, name: str, *, shape: tuple[int, ...]) -> Array:
    """Return actions or a state as float64 if they are finite, within limits and of this shape.

    Args:
        values: (..., columns).
        limits: (2, columns), smallest and largest values.
        name: name of the argument in error messages.
        shape: the expected shape.

    Raises:
        TypeError: values are not real numbers.
        ValueError: values have another shape, are not finite or lie outside the limits.
    """
    array = check_real(values, name, "fiu")
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
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
