"""Diffusion Policy's replay buffers: a zarr group with data/ and meta/episode_ends."""

import warnings
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.files import reading
from cotlearn.robots.episodes.checked import need

MARKS = (".zgroup", "zarr.json")  #: a folder with one of these files is a zarr group
#: Codecs of numbers, by their names in zarr's two formats. Others are not decoded: a file names its
#: own codecs, and some, as "pickle", run code that is in the file.
CODECS = {"blosc", "gzip", "lz4", "zlib", "zstd"}
CODECS |= {"bytes", "crc32c", "sharding_indexed", "transpose"}


def is_buffer(path: Path) -> bool:
    """Whether a folder or a zip file is a zarr group, or holds exactly one."""
    return ".zarr" in path.suffixes or len(_groups(path)) == 1


def read_buffer(path: str | Path, states: Sequence[str] = ("data/state",)) -> tuple[Any, ...]:
    """Reads states, actions and ends of a replay buffer (2303.04137).

    Files like `pusht_cchi_v7_replay.zarr` hold data/state (N, 5) with agent x and y, block x, y and
    angle, data/action (N, 2), and meta/episode_ends (E,). Images and key points are not read.

    Args:
        path: the folder, or a zip file of it or of what it contains.
        states: candidate names of the states; the first existing one is read.

    Returns:
        The arrays of states, actions and episode ends.

    Raises:
        ModuleNotFoundError: zarr is not installed.
        ValueError: the file is damaged, something is missing, or an array does not hold numbers or
            has a codec that is not in `CODECS`.

    Warns (UserWarning) of chunks that are not stored, which zarr reads as its fill value.
    """
    path, zarr = Path(path), need("zarr")
    if path.is_file() and not zipfile.is_zipfile(path):
        raise ValueError(f"{path} is damaged: it is neither a folder nor a whole zip file")
    storage = zarr.storage.LocalStore if path.is_dir() else zarr.storage.ZipStore
    inside = next(iter(_groups(path)), "")
    with reading(path, "no zarr group"):
        store = storage(path, read_only=True)
        group = zarr.open_group(store, mode="r", path=inside)
        held = [name for name in (*states, "data/action", "meta/episode_ends") if name in group]
    state = next((name for name in states if name in held), states[0])
    names = (state, "data/action", "meta/episode_ends")
    with store:
        if missing := [name for name in names if name not in held]:
            raise ValueError(f"{path} has no {', no '.join(missing)}: it is no replay buffer")
        return tuple(_numbers(path, group, name) for name in names)


def _groups(path: Path) -> list[str]:
    """Where zarr groups lie: [""] if the path is one, else the folders in it that are."""
    if path.is_dir():
        whole = any((path / mark).is_file() for mark in MARKS)
        inner = {file.parent.name for mark in MARKS for file in path.glob(f"*/{mark}")}
    elif zipfile.is_zipfile(path):
        with reading(path, "no zip file"), zipfile.ZipFile(path) as file:
            names = [Path(name) for name in file.namelist()]
        marked = [name for name in names if name.name in MARKS]
        whole = any(len(name.parts) == 1 for name in marked)
        inner = {name.parts[0] for name in marked if len(name.parts) == 2}
    else:
        return []
    return [""] if whole else sorted(inner)


def _numbers(path: Path, group: Any, name: str) -> np.ndarray[Any, Any]:
    """The values of an array, decoded only if it holds numbers and its codecs are known."""
    with reading(path, "no zarr group"):
        array = group[name]
        kind, codecs = array.dtype.kind, set(_codecs(array.metadata.to_dict()))
    if kind not in "fiu":
        raise ValueError(f"{path}: {name} must hold numbers, got {array.dtype}")
    if unknown := codecs - CODECS:
        known = ", ".join(sorted(CODECS))
        raise ValueError(
            f"{path}: {name} is stored with {', '.join(sorted(unknown))}, which is not decoded; "
            f"the codecs that are: {known}"
        )
    with reading(path, "no zarr group"):
        values, missing = np.asarray(array[:]), array.nchunks - array.nchunks_initialized
    if missing > 0:  # parts of a shard at the edge count as stored
        warnings.warn(
            f"{path}: {missing} of {array.nchunks} chunks of {name} are not stored, and read as "
            f"rows of {array.fill_value}: they held nothing else, or were lost",
            stacklevel=4,
        )
    return values


def _codecs(metadata: Any) -> Iterator[str]:
    """The names of all codecs in an array's metadata, in zarr's formats 2 and 3."""
    for key in ("compressor", "filters", "codecs", "index_codecs"):
        found = metadata.get(key) or ()
        for codec in [found] if isinstance(found, dict) else found:
            yield str(codec.get("id", codec.get("name")))
            yield from _codecs(codec.get("configuration") or {})
