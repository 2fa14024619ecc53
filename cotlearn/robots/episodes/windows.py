"""Windows: what a policy sees, what it predicts, in which frame, and on which scale."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.robots.episodes.checked import Array, Episodes
from cotlearn.robots.push_t.task import GOAL
from cotlearn.validation import check_choice, check_count

FRAMES = ("body", "world")
LABELS = ("action", "intention")
SCALES = ("deviation", "range")
FEATURES = 6  #: of one observed step


@dataclass(frozen=True)
class Windows:
    """How episodes become rows (x1, c) and how a row becomes actions again.

    c is the flattened history of observations, x1 the flattened chunk of actions, each coordinate
    scaled so that an interval of the training set's becomes [-1, 1]: its mean -+ its standard
    deviation, or its whole range. In the frame "body" an observed step is the agent's
    place, the goal's place, and the cosine and sine of the goal's angle, all seen from the T of
    that step; actions are seen from the T of the last one. In the frame "world" it is the agent's
    place, the T's place, and the cosine and sine of its angle. Make one with `Windows.fit`.

    Attributes:
        observe: steps that a policy sees, the present one last.
        predict: steps of a chunk, the present one first.
        frame: "body" or "world".
        observation_range: (2, 6), the values of each feature that become -1 and 1.
        action_range: (2, 2), the values of each coordinate that become -1 and 1.
    """

    observe: int
    predict: int
    frame: str
    observation_range: Array
    action_range: Array

    def __post_init__(self) -> None:
        check_count(self.observe, "observe")
        check_count(self.predict, "predict")
        check_choice(self.frame, "frame", FRAMES)
        for name, columns in (("observation_range", FEATURES), ("action_range", 2)):
            value = np.asarray(getattr(self, name), dtype=np.float64)
            if value.shape != (2, columns) or not np.isfinite(value).all():
                raise ValueError(f"{name} must be finite of shape (2, {columns}): {value.tolist()}")
            if (value[1] < value[0]).any():
                raise ValueError(f"{name} must hold the smallest values first: {value.tolist()}")
            object.__setattr__(self, name, value)

    @classmethod
    def fit(
        cls,
        episodes: Episodes,
        *,
        observe: int = 2,
        predict: int = 16,
        frame: str = "body",
        label: str = "action",
        scale: str = "deviation",
    ) -> Windows:
        """Takes the scale from the windows of training episodes.

        Args:
            episodes: to train on.
            observe: steps that a policy sees.
            predict: steps of a chunk.
            frame: "body" or "world".
            label: as in `dataset`.
            scale: "deviation" gives every coordinate mean 0 and variance 1, as the noise has;
                "range" fills [-1, 1], as Diffusion Policy does. Seen from the T, actions are
                mostly near and rarely far, and the range leaves them a seventh of the noise.
        """
        check_choice(scale, "scale", SCALES)
        unit = cls(observe, predict, frame, *(np.array([[-1.0] * n, [1.0] * n]) for n in (6, 2)))
        history, actions = unit.cut(episodes, label=label)
        seen = unit._features(history).reshape(-1, FEATURES)
        wanted = unit._into_frame(actions, history).reshape(-1, 2)
        ends = _deviation if scale == "deviation" else _range
        return cls(observe, predict, frame, ends(seen), ends(wanted))

    @property
    def dim(self) -> int:
        """Columns of x1: predict * 2."""
        return 2 * self.predict

    @property
    def condition_dim(self) -> int:
        """Columns of c: observe * 6."""
        return FEATURES * self.observe

    def cut(self, episodes: Episodes, *, label: str = "action") -> tuple[Array, Array]:
        """Every window, one for each row: histories (N, observe, 5) and actions (N, predict, 2).

        At both ends of an episode the first state and the last action are repeated.
        """
        check_choice(label, "label", LABELS)
        actions = episodes.action if label == "action" else episodes.intention
        if actions is None:
            raise ValueError(f"{episodes.name} has no intentions: use label='action'")
        row = np.arange(len(episodes.state))[:, None]
        first = np.repeat(episodes.starts, episodes.lengths)[:, None]
        last = np.repeat(episodes.ends, episodes.lengths)[:, None] - 1
        seen = np.maximum(row + np.arange(1 - self.observe, 1), first)
        done = np.minimum(row + np.arange(self.predict), last)
        return episodes.state[seen], actions[done]

    def dataset(self, episodes: Episodes, *, label: str = "action") -> Dataset:
        """All windows as rows: x1 (N, predict * 2), c (N, observe * 6), float32.

        Args:
            episodes: any.
            label: "action", what was done; or "intention", what the demonstrator meant before
                noise was added: right actions in the states that noise led to (DART, 1703.09327).
        """
        history, actions = self.cut(episodes, label=label)
        name = f"{episodes.name}: {len(episodes)} episodes, {label}s, {self.frame} frame"
        return Dataset(self.chunks(actions, history), self.condition(history), name=name)

    def condition(self, history: ArrayLike) -> Tensor:
        """c of shape (B, observe * 6), float32, from states (B, observe, 5)."""
        features = self._features(self.check_history(history))
        scaled = _scale(features, self.observation_range)
        return torch.from_numpy(scaled.reshape(len(scaled), -1)).float()

    def chunks(self, actions: ArrayLike, history: ArrayLike) -> Tensor:
        """x1 of shape (B, predict * 2), float32, from actions (B, predict, 2) in pixels."""
        history = self.check_history(history)
        wanted = np.asarray(actions, dtype=np.float64)
        if wanted.shape != (len(history), self.predict, 2):
            raise ValueError(
                f"actions must have shape {(len(history), self.predict, 2)}, got {wanted.shape}"
            )
        scaled = _scale(self._into_frame(wanted, history), self.action_range)
        return torch.from_numpy(scaled.reshape(len(scaled), -1)).float()

    def actions(self, x: Tensor, history: ArrayLike) -> Array:
        """Actions (B, predict, 2) in pixels, not clipped, from chunks x (B, predict * 2)."""
        history = self.check_history(history)
        if x.shape != (len(history), self.dim):
            raise ValueError(f"x must have shape {(len(history), self.dim)}, got {tuple(x.shape)}")
        values = x.detach().to("cpu", torch.float64).numpy().reshape(-1, self.predict, 2)
        low, high = self.action_range
        values = low + (values + 1) / 2 * (high - low)
        if self.frame == "world":
            return values
        pose = history[:, -1:, 2:]
        return _turn(values, pose[..., 2]) + pose[..., :2]

    def check_history(self, history: ArrayLike) -> Array:
        """Returns states (B, observe, 5) as float64 if they are finite."""
        array = np.asarray(history)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"history must hold real numbers, got {array.dtype}")
        if array.ndim != 3 or array.shape[1:] != (self.observe, 5) or len(array) == 0:
            raise ValueError(
                f"history must have shape (rows, {self.observe}, 5): agent x and y, T x, y and "
                f"angle of {self.observe} steps; got {array.shape}"
            )
        if not np.isfinite(array).all():
            bad = np.flatnonzero(~np.isfinite(array).all(axis=(1, 2)))
            raise ValueError(f"history has NaN or infinite values in rows {bad.tolist()[:5]}")
        return array.astype(np.float64)

    def about(self) -> dict[str, Any]:
        """Everything, JSON-compatible: `Windows.from_about(windows.about())` is the same."""
        return {
            "observe": self.observe,
            "predict": self.predict,
            "frame": self.frame,
            "observation_range": self.observation_range.tolist(),
            "action_range": self.action_range.tolist(),
        }

    @classmethod
    def from_about(cls, about: dict[str, Any]) -> Windows:
        """Takes back what `about` gave."""
        return cls(**{**about, **{n: np.array(about[n]) for n in about if n.endswith("range")}})

    def _features(self, history: Array) -> Array:
        """(B, observe, 6)."""
        agent, place, angle = history[..., :2], history[..., 2:4], history[..., 4]
        if self.frame == "body":
            agent = _turn(agent - place, -angle)
            place = _turn(np.array(GOAL[:2]) - place, -angle)
            angle = GOAL[2] - angle
        return np.concatenate(
            [agent, place, np.cos(angle)[..., None], np.sin(angle)[..., None]], -1
        )

    def _into_frame(self, actions: Array, history: Array) -> Array:
        if self.frame == "world":
            return actions
        pose = history[:, -1:, 2:]
        return _turn(actions - pose[..., :2], -pose[..., 2])


def _range(values: Array) -> Array:
    return np.array([values.min(axis=0), values.max(axis=0)])


def _deviation(values: Array) -> Array:
    varies = values.min(axis=0) < values.max(axis=0)  # whatever rounding says
    mean, deviation = values.mean(axis=0), np.where(varies, values.std(axis=0), 0.0)
    return np.array([mean - deviation, mean + deviation])


def _turn(points: Array, angle: Array) -> Array:
    """Points (..., 2) turned by angles (...)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def _scale(values: Array, ends: NDArray[np.float64]) -> Array:
    """Values to [-1, 1] by their range; what does not vary becomes 0."""
    low, high = ends
    width = np.where(high > low, high - low, 1.0)
    middle = np.where(high > low, (low + high) / 2, low)
    return 2 * (values - middle) / width
