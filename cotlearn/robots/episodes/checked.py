"""`Episodes`, validated arrays of demonstrations, and their split."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cotlearn.extras import how_to_install
from cotlearn.robots.task import Array, Task
from cotlearn.validation import check_count, check_has, check_real, check_seed

Index = NDArray[np.int64]

LONGEST = 10_000  #: steps of a history or a chunk; a policy's file could name any


@dataclass(frozen=True)
class Episodes:
    """Concatenated demonstrations; row t holds a state and the action taken in it.

    Attributes:
        state: (N, columns), states.
        action: (N, columns), actions.
        ends: (E,), exclusive end of each episode.
        task: the demonstrated task.
        name: where the episodes come from.
        intention: (N, columns), the demonstrator's actions before noise; None if unknown.
        seed: (E,), seeds of the starts, as in `env.reset(seed=...)`; None if unknown.
        mode: (E,), the modes that the demonstrator chose, 0, 1, ...; None if unknown.

    Raises:
        TypeError: an array does not hold real numbers, or `ends` does not hold integers.
        ValueError: shapes, ends or values do not fit; the message names the row.
    """

    state: Array
    action: Array
    ends: Index
    task: Task
    name: str = "episodes"
    intention: Array | None = None
    seed: Index | None = None
    mode: Index | None = None

    def __post_init__(self) -> None:
        check_has(self.task, "task", "a task, as find_task returns it", "state_limits")
        ends = self._set("ends", "iu", (np.size(self.ends),))
        if len(ends) == 0 or (np.diff(ends, prepend=0) < 1).any():
            raise ValueError(f"{self.name}: ends must rise, and begin above 0, got {ends}")
        self._set_table("state", self.task.state_limits)
        self._set_table("action", self.task.action_limits)
        if self.intention is not None:
            self._set_table("intention", self.task.action_limits)
        for name in ("seed", "mode"):
            if getattr(self, name) is not None:
                self._set(name, "iu", ends.shape)

    def __len__(self) -> int:
        return len(self.ends)

    @property
    def starts(self) -> Index:
        """The first row of each episode, (E,)."""
        return np.concatenate([[0], self.ends[:-1]])

    @property
    def lengths(self) -> Index:
        """The number of rows of each episode, (E,)."""
        return self.ends - self.starts

    def select(self, index: ArrayLike | Sequence[int]) -> Self:
        """The episodes with the numbers `index` (m,), in this order."""
        try:
            chosen = np.arange(len(self))[check_real(index, "index", "iub")]
        except IndexError as error:
            raise ValueError(f"index must fit the {len(self)} episodes, got {error}") from None
        lengths = self.lengths[chosen]
        ends = np.cumsum(lengths)
        rows = np.repeat(self.starts[chosen] - (ends - lengths), lengths) + np.arange(lengths.sum())
        return replace(
            self,
            state=self.state[rows],
            action=self.action[rows],
            ends=ends,
            intention=None if self.intention is None else self.intention[rows],
            seed=None if self.seed is None else self.seed[chosen],
            mode=None if self.mode is None else self.mode[chosen],
        )

    def _set(self, name: str, kinds: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Convert a field to float64 or int64 if its type and shape are right."""
        array = check_real(getattr(self, name), f"{self.name}: {name}", kinds)
        if array.shape != shape:
            raise ValueError(f"{self.name}: {name} has shape {array.shape}, expected {shape}")
        array = array.astype(np.int64 if kinds == "iu" else np.float64)
        object.__setattr__(self, name, array)
        return array

    def _set_table(self, name: str, limits: Array) -> None:
        """Convert a field with one row per step if its values are finite and within limits."""
        low, high = limits
        values = self._set(name, "fiu", (int(self.ends[-1]), len(low)))
        bad = ~((values >= low) & (values <= high)).all(axis=1)  # NaN is neither
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            episode = int(np.searchsorted(self.ends, row, side="right"))
            raise ValueError(
                f"{self.name}: {name} must be finite and between {low} and {high}, got "
                f"{values[row].tolist()} in row {row}, step {row - self.starts[episode]} of "
                f"episode {episode}; {int(bad.sum())} rows are like that"
            )


def split(
    episodes: Episodes, *, held_out: int, train: int | None = None, seed: int = 0
) -> tuple[Episodes, Episodes]:
    """Split at random by episode, so that windows of one episode are never on both sides.

    The held-out episodes depend only on `held_out` and `seed`: trainings on more or fewer episodes
    are validated on the same ones, and smaller training sets are subsets of larger ones.

    Args:
        episodes: at least held_out + 1 episodes.
        held_out: number of episodes for validation.
        train: number of training episodes; all others if None.
        seed: of the permutation.

    Returns:
        The training episodes and the held-out episodes.

    Raises:
        ValueError: held_out or train exceeds the number of episodes.
    """
    check_has(episodes, "episodes", "Episodes", "select")
    check_count(held_out, "held_out")
    seed = check_seed(seed)
    rest = len(episodes) - held_out
    if rest < 1:
        raise ValueError(f"held_out must be below the {len(episodes)} episodes, got {held_out}")
    if train is not None:
        check_count(train, "train", most=rest, of="the {} remaining episodes")
    order = np.random.default_rng(seed).permutation(len(episodes))
    kept = order[held_out:][:train]
    return episodes.select(np.sort(kept)), episodes.select(np.sort(order[:held_out]))


def window_rows(step: Index, ends: Index, observe: int, predict: int) -> tuple[Index, Index, Index]:
    """The rows of a window around each step: its end is repeated where an episode ends.

    Args:
        step: (n,), the rows of the present states.
        ends: (E,), exclusive end of each episode.
        observe: number of states, the present one the last.
        predict: number of actions, that in the present state the first.

    Returns:
        The rows of the states (n, observe) and of the actions (n, predict), and the episodes (n,).
    """
    episode = np.searchsorted(ends, step, side="right")
    first = np.concatenate([[0], ends[:-1]])[episode]
    before = np.maximum(step[:, None] + np.arange(1 - observe, 1), first[:, None])
    after = np.minimum(step[:, None] + np.arange(predict), ends[episode, None] - 1)
    return before, after, episode


def need(module: str) -> ModuleType:
    """Import an optional package for another project's format.

    Raises:
        ModuleNotFoundError: it is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        name = module.partition(".")[0]
        hint = f"{name} is not installed; install it with: {how_to_install('formats')}"
        raise ModuleNotFoundError(hint) from error
