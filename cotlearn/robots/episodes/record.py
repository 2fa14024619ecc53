"""Records demonstrations in parts, so that an interrupted recording can resume.

`cotlearn.robots.episodes.npz` documents the file format.
"""

import importlib.metadata
import shutil
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.interrupt import interrupt_between_steps
from cotlearn.progress import progress_bar
from cotlearn.robots.episodes.npz import Arrays, read_arrays, write_arrays
from cotlearn.robots.registry import find_task
from cotlearn.robots.task import Array, Expert, Task
from cotlearn.validation import check_count, check_seed

PART = 50  #: episodes in a part, the most that an interruption can lose


def record(path: str | Path, task: str = "push-t", *, episodes: int, seed: int) -> dict[str, Any]:
    """Records demonstrations; an interrupted recording resumes.

    Episode i derives its seeds only from (seed, i), so that on one machine the file is the same,
    bit for bit, however often the recording was interrupted. Finished parts are kept in a folder
    `<path>.parts`. An episode that misses the goal is replaced by one with the next seed.

    Args:
        path: the file to write; if it already holds this recording, nothing is done.
        task: name of a task in `cotlearn.robots.registry`.
        episodes: number of episodes.
        seed: of the recording.

    Returns:
        The metadata of the file.

    Raises:
        ValueError: the file or the parts belong to another recording.
        KeyboardInterrupt: Ctrl-C was pressed; finished parts are kept.
    """
    path, chosen = Path(path), find_task(task)
    episodes, seed = check_count(episodes, "episodes"), check_seed(seed)
    versions = {name: importlib.metadata.version(name) for name in chosen.packages}
    about: dict[str, Any] = {"task": chosen.title, "seed": seed, "versions": versions}
    if path.exists():
        stored = read_arrays(path)[1]
        if stored != {**about, "episodes": episodes, "replaced": stored.get("replaced")}:
            raise ValueError(f"{path} holds another recording: choose another file")
        return stored
    folder = path.with_name(path.name + ".parts")
    folder.mkdir(parents=True, exist_ok=True)
    parts, expert = [], chosen.expert()
    with progress_bar(total=episodes, what="episodes") as bar, interrupt_between_steps() as stop:
        for first in range(0, episodes, PART):
            numbers = range(first, min(first + PART, episodes))
            part = folder / f"{first:06d}-{numbers.stop:06d}.npz"
            try:
                arrays, stored = read_arrays(part)
                bar.update(len(numbers))
            except ValueError:  # missing or damaged: record it again
                arrays, stored = _record_part(chosen, expert, numbers, seed, bar, stop), about
                write_arrays(part, arrays, about)
            if stored != about:
                raise ValueError(f"{folder} holds parts of another recording: choose another file")
            parts.append(arrays)
    merged = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    lengths = [np.diff(part["episode_ends"], prepend=0) for part in parts]
    merged["episode_ends"] = np.cumsum(np.concatenate(lengths))
    replaced = int((merged["seed"] != [_seed(seed, i, 0) for i in range(episodes)]).sum())
    about |= {"episodes": episodes, "replaced": replaced}
    write_arrays(path, merged, about)
    shutil.rmtree(folder)
    return about


def _record_part(
    task: Task, expert: Expert, numbers: range, seed: int, bar: Any, stop: Event
) -> Arrays:
    found, seeds = [], []
    for number in numbers:
        if stop.is_set():
            raise KeyboardInterrupt(f"recording stopped before episode {number}")
        attempt = 0
        while not (episode := expert.episode(_seed(seed, number, attempt))).success:
            attempt += 1
        found.append(episode)
        seeds.append(_seed(seed, number, attempt))
        bar.update()
    states, actions = (task.state, task.state_units), (task.action, task.action_units)
    arrays: Arrays = {
        "state": rounded([episode.state for episode in found], *states),
        "action": rounded([episode.action for episode in found], *actions),
        "intention": rounded([episode.intention for episode in found], *actions),
        "episode_ends": np.cumsum([len(episode.action) for episode in found], dtype=np.int64),
        "seed": np.array(seeds, dtype=np.uint32),
    }
    if found[0].mode is not None:
        arrays["mode"] = np.array([episode.mode for episode in found], dtype=np.int8)
    return arrays


def rounded(
    pieces: list[Array], columns: tuple[str, ...], units: tuple[float, ...]
) -> NDArray[np.int16]:
    """Round to integer multiples of the units; a full turn of an angle wraps around 16 bits.

    Raises:
        ValueError: another column does not fit into 16 bits.
    """
    exact = np.rint(np.concatenate(pieces) / np.array(units)).astype(np.int64)
    stored = exact.astype(np.int16)
    turns = np.isclose(np.array(units) * 2**16, 2 * np.pi)
    lost = (stored != exact).any(axis=0) & ~turns
    for column in np.flatnonzero(lost):
        raise ValueError(
            f"{columns[column]} reaches {np.abs(exact[:, column]).max()} units of "
            f"{units[column]:g}, but a file holds 32767: give the task a larger unit"
        )
    return stored


def _seed(seed: int, episode: int, attempt: int) -> int:
    return int(np.random.SeedSequence([seed, episode]).generate_state(attempt + 1)[attempt])
