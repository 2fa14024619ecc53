"""Demonstrations of Push-T, step by step: simulates, records, and writes after each episode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.files import check_output
from cotlearn.robots.episodes.npz import Arrays, read_arrays, write_arrays
from cotlearn.robots.episodes.record import rounded
from cotlearn.robots.push_t import PUSH_T, Simulation, random_state
from cotlearn.robots.push_t.constants import MAX_STEPS, SIZE, SUCCESS
from cotlearn.validation import check_seed

LAST_SEED = 2**31  #: far below what the file can hold


class Recorder:
    """An episode at a time, in the file of `cotlearn.robots.episodes.read`.

    The file is written after each episode that reaches the goal, so a restart loses only the
    episode that was going on; an existing recording of the same demonstrator is continued, also
    where another recorder wrote to it in the meantime.

    Args:
        path: the `.npz` file, the only one that is written.
        seed: of the first start; the next episodes take the next ones.
        demonstrator: who pushes, in words; the file keeps them.

    Raises:
        ValueError: the file is damaged, holds another recording, or cannot be written.
    """

    def __init__(self, path: str | Path, *, seed: int = 0, demonstrator: str = "by hand") -> None:
        self.path = check_output(path, "path")
        if self.path.suffix != ".npz":
            raise ValueError(f"path must end in .npz, got {self.path}")
        self._first = check_seed(seed)
        if seed >= LAST_SEED:
            raise ValueError(f"seed must be below {LAST_SEED}, got {seed}")
        self._about = {"task": PUSH_T.title, "demonstrator": demonstrator}
        self._done: list[Arrays] = []
        self._stamp: tuple[int, int] | None = None
        self._read()
        self.note = ""
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
            "note": self.note,
        }

    @property
    def success(self) -> bool:
        """Whether the T lies on the goal."""
        return self._sim.coverage > SUCCESS

    def step(self, x: float, y: float) -> None:
        """Push towards (x, y), in pixels, for a tenth of a second; success ends the episode.

        The target is moved into the world and rounded to the unit of the file. After 300 steps the
        episode begins again. `note` says how the last episode ended.

        Raises:
            ValueError: the file was damaged, or replaced by another recording.
            OSError: it cannot be written. The episode goes on, and the next step tries again.
        """
        units = np.array(PUSH_T.action_units)
        action = np.rint(np.clip([x, y], 0.0, SIZE) / units) * units
        self._states.append(self._sim.state)
        self._actions.append(action)
        self._sim.step(*action.tolist())
        self.note = ""
        if self.success:
            self._keep()
            self.note = f"Recorded after {len(self._actions) / 10:.1f} s."
            self.begin()
        elif len(self._actions) >= MAX_STEPS:
            self.note = f"{MAX_STEPS / 10:.0f} s are over without success: not recorded."
            self.begin()

    def undo(self) -> None:
        """Drop the episode that is going on; if it has not begun, the last recorded one.

        Raises:
            ValueError: the file was damaged, or replaced by another recording.
            OSError: it cannot be written.
        """
        self.note = ""
        if not self._actions and self._done:
            self._read()
            self._write(self._done[:-1])
        self.begin()

    def _keep(self) -> None:
        action = rounded([np.array(self._actions)], PUSH_T.action, PUSH_T.action_units)
        episode: Arrays = {
            "state": rounded([np.array(self._states)], PUSH_T.state, PUSH_T.state_units),
            "action": action,
            "intention": action,
            "seed": np.array([self._seed], dtype=np.uint32),
        }
        self._read()
        self._write([*self._done, episode])

    def _read(self) -> None:
        """Take over the file if it is not as this recorder left it."""
        if self.path.exists() and self._stamp != _stamp(self.path):
            self._done = _episodes_in(self.path, self._about)
            self._stamp = _stamp(self.path)

    def _write(self, episodes: list[Arrays]) -> None:
        if episodes:
            arrays = {name: np.concatenate([e[name] for e in episodes]) for name in episodes[0]}
            lengths = [len(episode["action"]) for episode in episodes]
            arrays["episode_ends"] = np.cumsum(lengths, dtype=np.int64)
            write_arrays(self.path, arrays, self._about)
            self._stamp = _stamp(self.path)
        else:
            self.path.unlink(missing_ok=True)
        self._done = episodes


def _stamp(path: Path) -> tuple[int, int]:
    """Changes when the file is written: each writing makes a new one."""
    found = path.stat()
    return found.st_ino, found.st_mtime_ns


def _episodes_in(path: Path, wanted: dict[str, str]) -> list[Arrays]:
    """The episodes of a recording of the same task and demonstrator.

    Raises:
        ValueError: the file is damaged or of another recording.
    """
    arrays, about = read_arrays(path)
    if about != wanted:
        who = about.get("demonstrator", "another demonstrator")
        raise ValueError(
            f"path must be of {wanted['task']} {wanted['demonstrator']}, got {path} of "
            f"{about.get('task')} {who}: choose another file"
        )
    ends = arrays.pop("episode_ends")
    starts = np.concatenate([[0], ends[:-1]])
    return [
        {name: v[i : i + 1] if name == "seed" else v[a:b] for name, v in arrays.items()}
        for i, (a, b) in enumerate(zip(starts, ends, strict=True))
    ]
