"""Windows: what a policy observes and predicts, in which frame and on which scale."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.robots.episodes.checked import LONGEST, Episodes, window_rows
from cotlearn.robots.registry import find_task
from cotlearn.robots.task import Array, Frame, Task
from cotlearn.validation import check_array, check_choice, check_count

LABELS = ("action", "intention")
_RANGES = ("observation_range", "action_range")


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Converts episodes to rows (x1, c), and predicted rows back to actions.

    c is the flattened history of observations and x1 the flattened chunk of actions, both in a
    frame of the task. Each coordinate is scaled so that mean -+ standard deviation, or the whole
    range, of the training set becomes [-1, 1]. Create windows with `Windows.fit`.

    Attributes:
        task: the task of the states and actions.
        frame: a key of `task.frames`.
        observation_range: (2, F), the values of each feature that become -1 and 1.
        action_range: (2, A), the values of each coordinate that become -1 and 1.
        observe: number of observed steps, the current one last; at most 10,000.
        predict: number of steps in a chunk, the current one first; at most 10,000.
        knots: number of predicted points per chunk, evenly spaced in time and ending with the last
            action; a clamped cubic spline (at rest at both ends) fills in the other steps. If None,
            every step is predicted.
        open_loop: make one window per episode, from its first step, instead of one per step.

    Raises:
        ValueError: an option is out of range or unknown.
    """

    task: Task
    frame: str
    observation_range: Array
    action_range: Array
    observe: int = 2
    predict: int = 16
    knots: int | None = None
    open_loop: bool = False

    def __post_init__(self) -> None:
        check_count(self.observe, "observe", most=LONGEST)
        check_count(self.predict, "predict", most=LONGEST)
        check_choice(self.frame, "frame", tuple(self.task.frames))
        widths = self._frame.features, len(self.task.action)
        for name, width in zip(_RANGES, widths, strict=True):
            if getattr(self, name).size:  # `fit` finds them with windows that have none
                check_array(getattr(self, name), name, (2, width))
        if self.knots is not None:
            check_count(self.knots, "knots", most=self.predict, of="the {} predicted steps")

    @classmethod
    def fit(
        cls,
        episodes: Episodes,
        *,
        frame: str | None = None,
        label: str = "action",
        scale: str = "deviation",
        **shape: Any,
    ) -> Self:
        """Create windows with the scale of training episodes.

        Args:
            episodes: the training episodes.
            frame: a key of `episodes.task.frames`; the first if None.
            label: as in `dataset`.
            scale: "deviation" gives every coordinate mean 0 and variance 1, like the noise; "range"
                fills [-1, 1], as Diffusion Policy does. In the frame of Push-T's block, actions are
                mostly near and rarely far, so "range" leaves them a seventh of the noise's scale.
            shape: the attributes `observe`, `predict`, `knots` and `open_loop`.
        """
        ends = _SCALES[check_choice(scale, "scale", tuple(_SCALES))]
        task, later = episodes.task, np.empty((2, 0))
        frame = frame or next(iter(task.frames))
        raw = cls(task=task, frame=frame, observation_range=later, action_range=later, **shape)
        history, actions = raw.cut(episodes, label=label)
        features = raw._frame.observe(history)
        wanted = raw._at_knots(raw._frame.to_frame(actions, history))
        return replace(raw, observation_range=ends(features), action_range=ends(wanted))

    @property
    def points(self) -> int:
        """Number of points in x1: knots, or predict without knots."""
        return self.knots or self.predict

    @property
    def dim(self) -> int:
        """Columns of x1: points * A, where A is the dimension of an action."""
        return self.points * len(self.task.action)

    @property
    def condition_dim(self) -> int:
        """Columns of c: observe * F, where F is the number of features of a state."""
        return self._frame.features * self.observe

    def cut(self, episodes: Episodes, *, label: str = "action") -> tuple[Array, Array]:
        """Cut episodes into N windows: histories (N, observe, columns), actions (N, predict, A).

        At the ends of an episode the first state and the last action are repeated.
        """
        actions = episodes.action
        if check_choice(label, "label", LABELS) == "intention" and episodes.intention is not None:
            actions = episodes.intention
        step = episodes.starts if self.open_loop else np.arange(len(episodes.state))
        before, after, _ = window_rows(step, episodes.ends, self.observe, self.predict)
        return episodes.state[before], actions[after]

    def dataset(self, episodes: Episodes, *, label: str = "action") -> Dataset:
        """All windows as a `Dataset` with x1 (N, points * A) and c (N, observe * F), float32.

        Args:
            episodes: episodes of the same task.
            label: "action", the executed action; or "intention", the demonstrator's action before
                noise was added, if the episodes have it: the right action in states that noise led
                to (DART, 1703.09327).
        """
        history, actions = self.cut(episodes, label=label)
        name = f"{episodes.name}: {len(episodes)} episodes, {label}s, {self.frame} frame"
        return Dataset(self.chunks(actions, history), self.condition(history), name=name)

    def condition(self, history: Array) -> Tensor:
        """c of shape (B, observe * F), float32, from states (B, observe, columns)."""
        return _scaled(self._frame.observe(history), self.observation_range)

    def chunks(self, actions: Array, history: Array) -> Tensor:
        """x1 of shape (B, points * A), float32, from actions (B, predict, A) in the world."""
        return _scaled(self._at_knots(self._frame.to_frame(actions, history)), self.action_range)

    def actions(self, x: Tensor, history: Array) -> Array:
        """Actions (B, predict, A) in the world, not clipped, from chunks x (B, points * A)."""
        values = x.detach().to("cpu", torch.float64).numpy()
        values = values.reshape(len(values), self.points, -1)
        low, high = self.action_range
        values = self._between_knots(low + (values + 1) / 2 * (high - low), history)
        return self._frame.from_frame(values, history)

    def metadata(self) -> dict[str, Any]:
        """All attributes in a JSON-compatible form for `Windows.from_metadata`."""
        ranges = {name: getattr(self, name).tolist() for name in _RANGES}
        return {**vars(self), **ranges, "task": self.task.name}

    @classmethod
    def from_metadata(cls, metadata: dict[str, Any]) -> Self:
        """Create windows from what `metadata` returned."""
        ranges = {name: np.array(metadata[name]) for name in _RANGES}
        return cls(**{**metadata, **ranges, "task": find_task(metadata["task"])})

    @property
    def _frame(self) -> Frame:
        return self.task.frames[self.frame]

    @property
    def _knot_steps(self) -> NDArray[np.int64]:
        """The steps of a chunk, from 1 to predict, at which its knots lie."""
        return np.rint(np.arange(1, self.points + 1) * self.predict / self.points).astype(np.int64)

    def _at_knots(self, actions: Array) -> Array:
        return actions[:, self._knot_steps - 1]

    def _between_knots(self, values: Array, history: Array) -> Array:
        """Evaluate the spline through the tool's current position and the knots at every step."""
        if self.knots is None:
            return values
        from scipy.interpolate import CubicSpline  # late: it takes a second

        here = self._frame.to_frame(history[:, -1:, : values.shape[-1]], history)
        times = np.concatenate([[0], self._knot_steps])
        path = CubicSpline(times, np.concatenate([here, values], axis=1), axis=1, bc_type="clamped")
        return np.asarray(path(np.arange(1, self.predict + 1)))


def _range(values: Array) -> Array:
    """The smallest and the largest value of each column, (2, columns), of (B, n, columns)."""
    return np.array([values.min(axis=(0, 1)), values.max(axis=(0, 1))])


def _deviation(values: Array) -> Array:
    """Mean -+ standard deviation of each column, (2, columns), of (B, n, columns)."""
    values = values.reshape(-1, values.shape[-1])
    varies = values.min(axis=0) < values.max(axis=0)  # rounding can make a constant's std above 0
    mean, deviation = values.mean(axis=0), np.where(varies, values.std(axis=0), 0.0)
    return np.array([mean - deviation, mean + deviation])


_SCALES = {"deviation": _deviation, "range": _range}


def _scaled(values: Array, ends: Array) -> Tensor:
    """Rows (B, n * columns) in float32, scaled so that `ends` become -1 and 1; constants give 0."""
    low, high = ends
    scaled = 2 * (values - (low + high) / 2) / np.where(high > low, high - low, 1.0)
    return torch.from_numpy(scaled.reshape(len(scaled), -1)).float()
