"""Demonstrations on disk: recorded in parts, so that an interrupted recording goes on.

The file is an `.npz` without pickles, with these arrays:

- state, int16 (N, columns): before each control step, rounded to the units of its `Recipe`;
- action, int16 (N, columns): what was done in that state, exact;
- intention, int16 (N, columns): what the expert meant before noise was added, exact;
- episode_ends, int64 (E,): where each episode ends, exclusive, as in Diffusion Policy's files;
- seed, uint32 (E,): `env.reset(seed=...)` gives the start of the episode, exactly;
- mode, int8 (E,): which way the expert chose, if the task tells several apart;
- about: a JSON text: how the file was made, and the SHA-256 of the arrays.
"""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import math
import shutil
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.progress import progress_bar
from cotlearn.robots.arm.task import KINDS, columns
from cotlearn.robots.experts.arm import ArmExpert
from cotlearn.robots.experts.arm.expert import UNIT
from cotlearn.robots.experts.push_t import PushTExpert
from cotlearn.storage import atomic_path
from cotlearn.validation import check_choice, check_count

Arrays = dict[str, NDArray[Any]]

PIXEL = 1 / 32
TURN = 2 * math.pi / 65536
PART = 50  #: episodes that an interruption can cost at most


@dataclass(frozen=True)
class Recipe:
    """How the demonstrations of a task are made and stored.

    Attributes:
        title: of the task, as the file has it.
        expert: makes what has `episode(seed)`.
        packages: whose versions the file notes.
        state: the units of a state's columns.
        action: the units of an action's columns.
        modes: whether episodes have a mode.
    """

    title: str
    expert: Callable[[], Any]
    packages: tuple[str, ...]
    state: tuple[float, ...]
    action: tuple[float, ...]
    modes: bool = False

    @property
    def layout(self) -> dict[str, tuple[str, int]]:
        """Name of an array: type, columns (0: one number a row)."""
        fixed = {
            "state": ("int16", len(self.state)),
            "action": ("int16", len(self.action)),
            "intention": ("int16", len(self.action)),
            "episode_ends": ("int64", 0),
            "seed": ("uint32", 0),
        }
        return {**fixed, "mode": ("int8", 0)} if self.modes else fixed


RECIPES = {
    # an angle fills the 16 bits, and wraps round as they do
    "push-t": Recipe(
        "Push-T",
        expert=lambda: PushTExpert(),
        packages=("numpy", "pymunk"),
        state=(PIXEL,) * 4 + (TURN,),
        action=(PIXEL,) * 2,
    ),
    **{
        f"arm-{kind}": Recipe(
            f"arm-{kind}",
            expert=functools.partial(ArmExpert, kind),
            packages=("numpy", "mujoco"),
            state=(UNIT,) * len(columns(kind)),
            action=(UNIT,) * 3,
            modes=True,
        )
        for kind in KINDS
    },
}


@dataclass(frozen=True)
class Demonstrations:
    """Recorded episodes, one after the other; row t holds the state and the action taken in it.

    Attributes:
        state: (N, columns) float64, to half a unit: pixels and radians in [-π, π), or metres.
        action: (N, columns) float64, what was done, exact.
        intention: (N, columns) float64, what the expert meant, exact.
        episode_ends: (E,), where each episode ends, exclusive.
        seed: (E,), of the starts.
        about: how the file was made.
        mode: (E,), the number of the way that was chosen; None if the task has but one.
    """

    state: NDArray[np.float64]
    action: NDArray[np.float64]
    intention: NDArray[np.float64]
    episode_ends: NDArray[np.int64]
    seed: NDArray[np.uint32]
    about: dict[str, Any]
    mode: NDArray[np.int8] | None = None


def record(
    path: str | Path,
    task: str = "push-t",
    *,
    episodes: int,
    seed: int,
    show_progress: bool | None = None,
) -> dict[str, Any]:
    """Records demonstrations; goes on where an interrupted recording stopped.

    Episode i derives its seeds from (seed, i) alone, so that the file is the same, bit for bit, on
    one machine, however often the recording was interrupted. Finished parts wait in a folder
    `<path>.parts`. An episode that misses the goal is replaced by one with the next seed.

    Args:
        path: the file to make; nothing is done if it holds this very recording already.
        task: "push-t", "arm-ring" or "arm-avoid".
        episodes: how many.
        seed: of the recording.
        show_progress: True or False; None decides by the terminal.

    Returns:
        What the file says about itself.

    Raises:
        ValueError: the file or the parts belong to another recording.
    """
    path = Path(path)
    episodes, seed = check_count(episodes, "episodes"), check_count(seed, "seed", minimum=0)
    recipe = RECIPES[check_choice(task, "task", tuple(RECIPES))]
    about = _about(recipe, seed)
    if path.exists():
        stored = read(path)[1]
        if stored != {**about, "episodes": episodes, "replaced": stored.get("replaced")}:
            raise ValueError(f"{path} holds another recording: choose another file")
        return stored
    folder = path.with_name(path.name + ".parts")
    folder.mkdir(parents=True, exist_ok=True)
    parts, expert = [], None
    with progress_bar(total=episodes, what="episodes", show=show_progress) as bar:
        for first in range(0, episodes, PART):
            count = min(PART, episodes - first)
            part = folder / f"{first:06d}-{first + count:06d}.npz"
            arrays = _stored_part(part, about)
            if arrays is None:
                expert = expert or recipe.expert()
                arrays = _record_part(recipe, expert, first, count, seed, bar)
                write(part, arrays, about)
            else:
                bar.update(count)
            parts.append(arrays)
    merged = {name: np.concatenate([part[name] for part in parts]) for name in recipe.layout}
    merged["episode_ends"] = np.cumsum(
        np.concatenate([np.diff(part["episode_ends"], prepend=0) for part in parts])
    )
    replaced = int((merged["seed"] != [_seed(seed, i, 0) for i in range(episodes)]).sum())
    about = {**about, "episodes": episodes, "replaced": replaced}
    write(path, merged, about)
    shutil.rmtree(folder)
    return about


def load(path: str | Path) -> Demonstrations:
    """Reads and checks demonstrations.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged or something else; says what is wrong.
    """
    arrays, about = read(path)
    recipe = _recipe(path, about)
    return Demonstrations(
        state=arrays["state"] * np.array(recipe.state),
        action=arrays["action"] * np.array(recipe.action),
        intention=arrays["intention"] * np.array(recipe.action),
        episode_ends=arrays["episode_ends"],
        seed=arrays["seed"],
        about=about,
        mode=arrays.get("mode"),
    )


def write(path: Path, arrays: Arrays, about: dict[str, Any]) -> None:
    """Writes arrays of the layout above, atomically; the same arrays give the same bytes."""
    text = json.dumps({"about": about, "sha256": _digest(arrays)}, sort_keys=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, about=np.array(text), **arrays)


def read(path: str | Path) -> tuple[Arrays, dict[str, Any]]:
    """Reads the integer arrays that `write` wrote, and checks that all is there and fits."""
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files if name != "about"}
            record = json.loads(str(file["about"]))
        about, digest = dict(record["about"]), record["sha256"]
    except KeyError as error:
        raise ValueError(f"{path} is not a file of demonstrations: no {error}") from error
    except (
        ValueError,
        TypeError,
        OSError,
        EOFError,
        RuntimeError,
        zipfile.BadZipFile,
        zlib.error,
    ) as error:
        raise ValueError(f"{path} is damaged or not an .npz file: {error}") from error
    recipe = _recipe(path, about)
    for name, (kind, width) in recipe.layout.items():
        if name not in arrays:
            raise ValueError(f"{path} is not a file of {recipe.title} demonstrations: no {name!r}")
        array = arrays[name]
        shape = (len(array), width) if width else (len(array),)
        if array.dtype != kind or array.shape != shape:
            raise ValueError(
                f"{path}: {name} is {array.dtype} of shape {array.shape}, expected {kind} of "
                f"shape {('rows', width) if width else ('episodes',)}"
            )
    ends = arrays["episode_ends"]
    rows = len(arrays["state"])
    if len(ends) == 0 or ends[-1] != rows or (np.diff(ends, prepend=0) < 1).any():
        raise ValueError(f"{path}: episode_ends must rise to the number of rows, {rows}")
    for name, (_, width) in recipe.layout.items():
        expected = rows if width else len(ends)
        if len(arrays[name]) != expected:
            raise ValueError(f"{path}: arrays do not fit: {name} has not {expected} rows")
    if digest != _digest(arrays):
        raise ValueError(f"{path} is damaged: its arrays do not match their SHA-256")
    return arrays, about


def _recipe(path: str | Path, about: dict[str, Any]) -> Recipe:
    for recipe in RECIPES.values():
        if recipe.title == about.get("task"):
            return recipe
    raise ValueError(f"{path} holds demonstrations of an unknown task, {about.get('task')!r}")


def _about(recipe: Recipe, seed: int) -> dict[str, Any]:
    versions = {name: importlib.metadata.version(name) for name in recipe.packages}
    return {"task": recipe.title, "seed": seed, "versions": versions}


def _stored_part(path: Path, about: dict[str, Any]) -> Arrays | None:
    try:
        arrays, stored = read(path)
    except (FileNotFoundError, ValueError):
        return None  # missing or damaged: it is made anew
    if stored != about:
        raise ValueError(f"{path.parent} holds parts of another recording: choose another file")
    return arrays


def _record_part(
    recipe: Recipe, expert: Any, first: int, count: int, seed: int, bar: Any
) -> Arrays:
    found, seeds = [], []
    for index in range(first, first + count):
        attempt = 0
        while not (episode := expert.episode(_seed(seed, index, attempt))).success:
            attempt += 1
        found.append(episode)
        seeds.append(_seed(seed, index, attempt))
        bar.update()
    arrays: Arrays = {
        "state": _rounded([episode.state for episode in found], recipe.state),
        "action": _rounded([episode.action for episode in found], recipe.action),
        "intention": _rounded([episode.intention for episode in found], recipe.action),
        "episode_ends": np.cumsum([len(episode.action) for episode in found], dtype=np.int64),
        "seed": np.array(seeds, dtype=np.uint32),
    }
    if recipe.modes:
        arrays["mode"] = np.array([episode.mode for episode in found], dtype=np.int8)
    return arrays


def _rounded(pieces: list[NDArray[np.float64]], units: tuple[float, ...]) -> NDArray[np.int16]:
    return np.rint(np.concatenate(pieces) / np.array(units)).astype(np.int64).astype(np.int16)


def _seed(seed: int, episode: int, attempt: int) -> int:
    return int(np.random.SeedSequence([seed, episode]).generate_state(attempt + 1)[attempt])


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
