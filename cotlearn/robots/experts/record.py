"""Demonstrations of Push-T on disk: recorded in parts, so that an interrupted recording goes on.

The file is an `.npz` without pickles, with these arrays:

- state, int16 (N, 5): agent x and y, T x and y in 1/32 pixel, T angle in 2π/65536, rounded;
- action, int16 (N, 2): what was done in that state, in 1/32 pixel, exact;
- intention, int16 (N, 2): what the expert meant before noise was added, in 1/32 pixel, exact;
- episode_ends, int64 (E,): where each episode ends, exclusive, as in Diffusion Policy's files;
- seed, uint32 (E,): `env.reset(seed=...)` gives the start of the episode, exactly;
- about: a JSON text: how the file was made, and the SHA-256 of the arrays.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import shutil
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.progress import progress_bar
from cotlearn.robots.experts.push_t import Episode, PushTExpert
from cotlearn.storage import atomic_path
from cotlearn.validation import check_count

Arrays = dict[str, NDArray[Any]]

PIXEL = 1 / 32
TURN = 2 * math.pi / 65536
PART = 50  #: episodes that an interruption can cost at most

_LAYOUT = {  # name: type, columns (0: one number a row)
    "state": ("int16", 5),
    "action": ("int16", 2),
    "intention": ("int16", 2),
    "episode_ends": ("int64", 0),
    "seed": ("uint32", 0),
}


@dataclass(frozen=True)
class Demonstrations:
    """Recorded episodes, one after the other; row t holds the state and the action taken in it.

    Attributes:
        state: (N, 5) float64, agent x and y, T x, y (to 1/64 pixel) and angle in [-π, π).
        action: (N, 2) float64, what was done, pixels, exact.
        intention: (N, 2) float64, what the expert meant, pixels, exact.
        episode_ends: (E,), where each episode ends, exclusive.
        seed: (E,), of the starts.
        about: how the file was made.
    """

    state: NDArray[np.float64]
    action: NDArray[np.float64]
    intention: NDArray[np.float64]
    episode_ends: NDArray[np.int64]
    seed: NDArray[np.uint32]
    about: dict[str, Any]


def record(
    path: str | Path, *, episodes: int, seed: int, show_progress: bool | None = None
) -> dict[str, Any]:
    """Records demonstrations; goes on where an interrupted recording stopped.

    Episode i derives its seeds from (seed, i) alone, so that the file is the same, bit for bit, on
    one machine, however often the recording was interrupted. Finished parts wait in a folder
    `<path>.parts`. An episode that misses the goal is replaced by one with the next seed.

    Args:
        path: the file to make; nothing is done if it holds this very recording already.
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
    about = _about(seed)
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
                expert = expert or PushTExpert()
                arrays = _record_part(expert, first, count, seed, bar)
                write(part, arrays, about)
            else:
                bar.update(count)
            parts.append(arrays)
    merged = {name: np.concatenate([part[name] for part in parts]) for name in _LAYOUT}
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
    state = arrays["state"] * np.array([PIXEL] * 4 + [TURN])
    return Demonstrations(
        state=state,
        action=arrays["action"] * PIXEL,
        intention=arrays["intention"] * PIXEL,
        episode_ends=arrays["episode_ends"],
        seed=arrays["seed"],
        about=about,
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
            arrays = {name: file[name] for name in _LAYOUT}
            record = json.loads(str(file["about"]))
        about, digest = dict(record["about"]), record["sha256"]
    except KeyError as error:
        raise ValueError(f"{path} is not a file of Push-T demonstrations: no {error}") from error
    except (ValueError, TypeError, OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path} is damaged or not an .npz file: {error}") from error
    for name, (kind, columns) in _LAYOUT.items():
        array = arrays[name]
        shape = (len(array), columns) if columns else (len(array),)
        if array.dtype != kind or array.shape != shape:
            raise ValueError(
                f"{path}: {name} is {array.dtype} of shape {array.shape}, expected {kind} of "
                f"shape {('rows', columns) if columns else ('episodes',)}"
            )
    ends = arrays["episode_ends"]
    rows = len(arrays["state"])
    if len(ends) == 0 or ends[-1] != rows or (np.diff(ends, prepend=0) < 1).any():
        raise ValueError(f"{path}: episode_ends must rise to the number of rows, {rows}")
    if {len(arrays["action"]), len(arrays["intention"])} != {rows} or len(arrays["seed"]) != len(
        ends
    ):
        raise ValueError(f"{path}: state, action, intention, episode_ends and seed do not fit")
    if digest != _digest(arrays):
        raise ValueError(f"{path} is damaged: its arrays do not match their SHA-256")
    return arrays, about


def _about(seed: int) -> dict[str, Any]:
    versions = {name: importlib.metadata.version(name) for name in ("numpy", "pymunk")}
    return {"task": "Push-T", "seed": seed, "versions": versions}


def _stored_part(path: Path, about: dict[str, Any]) -> Arrays | None:
    try:
        arrays, stored = read(path)
    except (FileNotFoundError, ValueError):
        return None  # missing or damaged: it is made anew
    if stored != about:
        raise ValueError(f"{path.parent} holds parts of another recording: choose another file")
    return arrays


def _record_part(expert: PushTExpert, first: int, count: int, seed: int, bar: Any) -> Arrays:
    found, seeds = [], []
    for index in range(first, first + count):
        attempt = 0
        while not (episode := expert.episode(_seed(seed, index, attempt))).success:
            attempt += 1
        found.append(episode)
        seeds.append(_seed(seed, index, attempt))
        bar.update()
    return {**_quantised(found), "seed": np.array(seeds, dtype=np.uint32)}


def _quantised(episodes: list[Episode]) -> Arrays:
    state = np.concatenate([episode.state for episode in episodes])
    angle = np.rint(state[:, 4] / TURN).astype(np.int64).astype(np.int16)  # wraps round a turn
    return {
        "state": np.column_stack([np.rint(state[:, :4] / PIXEL).astype(np.int16), angle]),
        "action": _in_pixels([episode.action for episode in episodes]),
        "intention": _in_pixels([episode.intention for episode in episodes]),
        "episode_ends": np.cumsum([len(episode.action) for episode in episodes], dtype=np.int64),
    }


def _in_pixels(pieces: list[NDArray[np.float64]]) -> NDArray[np.int16]:
    return np.rint(np.concatenate(pieces) / PIXEL).astype(np.int16)


def _seed(seed: int, episode: int, attempt: int) -> int:
    return int(np.random.SeedSequence([seed, episode]).generate_state(attempt + 1)[attempt])


def _digest(arrays: Arrays) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(f"{name} {arrays[name].dtype} {arrays[name].shape}".encode())
        digest.update(np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()
