"""Episodes as arrays, checked."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.task import Array, Task
from cotlearn.validation import check_count


@dataclass(frozen=True)
class Episodes:
    """Demonstrations, one after the other; row t holds a state and the action taken in it.

    Attributes:
        state: (N, columns of the task's states).
        action: (N, columns of its actions).
        ends: (E,), where each episode ends, exclusive.
        name: where they come from.
        intention: as action, what the demonstrator meant before noise was added; None if unknown.
        seed: (E,), `env.reset(seed=...)` gives the start; None if unknown.
        mode: (E,), which way of doing it the demonstrator took, 0, 1, ...; None if unknown.
        task: what was demonstrated.

    Raises:
        TypeError: an array does not hold real numbers.
        ValueError: shapes, ends or values do not fit; says where.
    """

    state: Array
    action: Array
    ends: NDArray[np.int64]
    name: str = "episodes"
    intention: Array | None = None
    seed: NDArray[np.int64] | None = None
    mode: NDArray[np.int64] | None = None
    task: Task = PUSH_T

    def __post_init__(self) -> None:
        columns = len(self.task.action)
        rows = self._set("state", self.state, None, len(self.task.state))
        self._set("action", self.action, rows, columns)
        if self.intention is not None:
            self._set("intention", self.intention, rows, columns)
        ends = np.asarray(self.ends)
        if ends.dtype.kind not in "iu" or ends.ndim != 1:
            raise TypeError(
                f"{self.name}: ends must be a vector of integers, got {ends.dtype} of shape "
                f"{ends.shape}"
            )
        if (
            len(ends) == 0
            or ends[-1] != rows
            or (np.diff(ends.astype(np.int64), prepend=0) < 1).any()
        ):
            raise ValueError(
                f"{self.name}: ends must rise to the number of rows {rows}, got "
                f"{ends.tolist()[:5]}{' ...' if len(ends) > 5 else ''}"
            )
        object.__setattr__(self, "ends", ends.astype(np.int64))
        for name in ("seed", "mode"):
            value = getattr(self, name)
            if value is None:
                continue
            if np.shape(value) != ends.shape:
                raise ValueError(
                    f"{self.name}: {name} has shape {np.shape(value)}, there are {len(ends)} "
                    "episodes"
                )
            object.__setattr__(self, name, np.asarray(value, dtype=np.int64))
        self._check_values("state", self.task.state_limits)
        for name in ("action", "intention"):
            self._check_values(name, self.task.action_limits)

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def starts(self) -> NDArray[np.int64]:
        """(E,), the first row of each episode."""
        return np.concatenate([[0], self.ends[:-1]])

    @property
    def lengths(self) -> NDArray[np.int64]:
        """(E,), the rows of each episode."""
        return self.ends - self.starts

    def select(self, index: ArrayLike | Sequence[int]) -> Episodes:
        """Some of the episodes, in the order of their numbers `index`."""
        chosen = np.asarray(index)
        if chosen.ndim != 1 or len(chosen) == 0 or chosen.dtype.kind not in "iu":
            raise ValueError(f"index must be a list of episode numbers, got {index!r}")
        if chosen.min() < 0 or chosen.max() >= len(self):
            raise ValueError(
                f"index must lie between 0 and {len(self) - 1}, got {chosen.min()} to "
                f"{chosen.max()}"
            )
        lengths = self.lengths[chosen]
        ends = np.cumsum(lengths)
        rows = np.repeat(self.starts[chosen] - (ends - lengths), lengths) + np.arange(ends[-1])
        return replace(
            self,
            state=self.state[rows],
            action=self.action[rows],
            ends=ends,
            intention=None if self.intention is None else self.intention[rows],
            seed=None if self.seed is None else self.seed[chosen],
            mode=None if self.mode is None else self.mode[chosen],
        )

    def _set(self, name: str, value: Any, rows: int | None, columns: int) -> int:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"{self.name}: {name} must hold real numbers, got {array.dtype}")
        if array.ndim != 2 or array.shape[1] != columns or len(array) == 0:
            raise ValueError(
                f"{self.name}: {name} must have shape (rows, {columns}), got {array.shape}"
            )
        if rows is not None and len(array) != rows:
            raise ValueError(f"{self.name}: {name} has {len(array)} rows, state has {rows}")
        object.__setattr__(self, name, array.astype(np.float64))
        return len(array)

    def _check_values(self, name: str, limits: Array) -> None:
        values = getattr(self, name)
        if values is None:
            return
        low, high = limits
        with np.errstate(invalid="ignore"):
            good = np.isfinite(values) & (values >= low) & (values <= high)
        if not good.all():
            row = int(np.flatnonzero(~good.all(axis=1))[0])
            episode = int(np.searchsorted(self.ends, row, side="right"))
            raise ValueError(
                f"{self.name}: {name} must be finite and between {low} and {high}, got "
                f"{values[row].tolist()} in row {row}, step {row - self.starts[episode]} of "
                f"episode {episode}; {int((~good).any(axis=1).sum())} rows are like that"
            )


def split(
    episodes: Episodes, *, held_out: int, train: int | None = None, seed: int = 0
) -> tuple[Episodes, Episodes]:
    """Splits by episode, at random: windows of one episode never stand on both sides.

    The held-out episodes depend on `held_out` and `seed` alone, so that trainings on more and on
    fewer episodes are judged by the same ones, and smaller training sets are parts of larger ones.

    Args:
        episodes: at least held_out + 1.
        held_out: episodes to keep for validation.
        train: episodes to train on; all others if None.
        seed: of the permutation.

    Returns:
        The episodes to train on, and those held out.
    """
    check_count(held_out, "held_out")
    rest = len(episodes) - held_out
    if rest < 1:
        raise ValueError(f"held_out must be below the {len(episodes)} episodes, got {held_out}")
    if train is not None and check_count(train, "train") > rest:
        raise ValueError(f"train must be at most the {rest} episodes that are left, got {train}")
    order = np.random.default_rng(seed).permutation(len(episodes))
    kept = order[held_out:][:train]
    return episodes.select(np.sort(kept)), episodes.select(np.sort(order[:held_out]))


def need(module: str) -> ModuleType:
    """Imports a package that only foreign formats need."""
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"{module.partition('.')[0]} is not installed; install it with: "
            "pip install 'cotlearn[formats]'"
        ) from error
