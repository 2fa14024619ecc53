"""Demonstrations of Push-T by hand: simulates, records, and writes after each episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.robots.episodes.npz import Arrays, read_arrays, write_arrays
from cotlearn.robots.episodes.record import rounded
from cotlearn.robots.push_t import PUSH_T, Simulation, random_state
from cotlearn.robots.push_t.constants import MAX_STEPS, SIZE, SUCCESS
from cotlearn.validation import check_output, check_seed

ABOUT = {"task": PUSH_T.title, "demonstrator": "by hand"}


class Recorder:
    """An episode at a time, in the file of `cotlearn.robots.episodes.read`.

    The file is written after each episode that reaches the goal, so a restart loses only the
    episode that was going on; an existing recording by hand is continued.

    Args:
        path: the `.npz` file, the only one that is written.
        seed: of the first start; the next episodes take the next ones.

    Raises:
        ValueError: the file is damaged, holds another recording, or cannot be written.
    """

    def __init__(self, path: str | Path, *, seed: int = 0) -> None:
        self.path = check_output(path, "path")
        if self.path.suffix != ".npz":
            raise ValueError(f"path must end in .npz, got {self.path}")
        self._first = check_seed(seed)
        self._done: list[Arrays] = _episodes_in(self.path) if self.path.exists() else []
        self.begin()

    def __len__(self) -> int:
        return len(self._done)

    def begin(self) -> None:
        """Start the next episode; the steps of one that was not finished are dropped."""
        seeds = [int(episode["seed"][0]) for episode in self._done]
        self._seed = max([self._first - 1, *seeds]) + 1
        self._sim = Simulation(random_state(np.random.default_rng(self._seed)))
        self._states: list[Any] = []
        self._actions: list[Any] = []

    @property
    def view(self) -> dict[str, Any]:
        """What the hand sees: the state, the coverage, the step, and how many are recorded."""
        return {
            "state": [round(value, 2) for value in self._sim.state[:4]] + [self._sim.state[4]],
            "coverage": self._sim.coverage,
            "step": len(self._actions),
            "recorded": len(self),
            "success": self.success,
        }

    @property
    def success(self) -> bool:
        """Whether the T lies on the goal."""
        return self._sim.coverage > SUCCESS

    def step(self, x: float, y: float) -> None:
        """Push towards (x, y), in pixels, for a tenth of a second; success ends the episode.

        The target is moved into the world and rounded to the unit of the file. After 300 steps the
        episode begins again.
        """
        units = np.array(PUSH_T.action_units)
        action = np.rint(np.clip([x, y], 0.0, SIZE) / units) * units
        self._states.append(self._sim.state)
        self._actions.append(action)
        self._sim.step(*action.tolist())
        if self.success:
            self._keep()
            self.begin()
        elif len(self._actions) >= MAX_STEPS:
            self.begin()

    def undo(self) -> None:
        """Drop the episode that is going on; if it has not begun, the last recorded one."""
        if not self._actions and self._done:
            self._done.pop()
            self._write()
        self.begin()

    def _keep(self) -> None:
        action = rounded([np.array(self._actions)], PUSH_T.action, PUSH_T.action_units)
        episode: Arrays = {
            "state": rounded([np.array(self._states)], PUSH_T.state, PUSH_T.state_units),
            "action": action,
            "intention": action,
            "seed": np.array([self._seed], dtype=np.uint32),
        }
        self._done.append(episode)
        self._write()

    def _write(self) -> None:
        if not self._done:
            self.path.unlink(missing_ok=True)
            return
        arrays = {name: np.concatenate([e[name] for e in self._done]) for name in self._done[0]}
        lengths = [len(episode["action"]) for episode in self._done]
        arrays["episode_ends"] = np.cumsum(lengths, dtype=np.int64)
        write_arrays(self.path, arrays, ABOUT)


def _episodes_in(path: Path) -> list[Arrays]:
    """The episodes of a recording by hand.

    Raises:
        ValueError: the file is damaged or of another recording.
    """
    arrays, about = read_arrays(path)
    if about != ABOUT:
        raise ValueError(f"{path} holds another recording: choose another file")
    ends = arrays.pop("episode_ends")
    starts = np.concatenate([[0], ends[:-1]])
    return [
        {name: v[i : i + 1] if name == "seed" else v[a:b] for name, v in arrays.items()}
        for i, (a, b) in enumerate(zip(starts, ends, strict=True))
    ]
