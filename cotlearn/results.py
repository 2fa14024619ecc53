"""Results on disk: cells that are computed once and stored with versions and machine."""

import contextlib
import importlib.metadata
import json
import os
import platform
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from functools import partial
from pathlib import Path
from typing import Any

import torch

from cotlearn.files import write_text
from cotlearn.validation import check_choice

Values = dict[str, Any]
Say = Callable[[str], None]


def machine(*packages: str) -> Values:
    """Versions of Python, torch, numpy, scipy and `packages`, and a description of the hardware."""
    names = ("torch", "numpy", "scipy", *packages)
    versions = {name: importlib.metadata.version(name) for name in names}
    versions = {"python": platform.python_version(), **versions}
    core = f"one of {os.cpu_count()} CPU cores of a shared server, {platform.machine()}"
    return {"versions": versions, "machine": f"{core}, {torch.get_num_threads()} thread"}


def write_json(path: Path, value: Any) -> None:
    """Writes JSON atomically, with each innermost list of numbers on one line."""
    text = json.dumps(value, indent=1, allow_nan=False)
    text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    write_text(path, text + "\n")


def read_json(path: Path, *keys: str) -> Values:
    """Reads a file written by `write_json`, which must contain the keys.

    Raises:
        ValueError: the file is damaged or lacks a key.
    """
    try:
        found: Values = json.loads(path.read_text(encoding="utf-8"))
        if missing := [key for key in keys if key not in found]:
            raise ValueError(f"it has no {missing[0]}")
    except ValueError as error:
        raise ValueError(f"{path} is damaged: delete it to make it again ({error})") from error
    return found


class Store:
    """Abstract base class of stores: computes missing cells, and resumes after an interruption.

    A subclass implements `holds(key)`, whether a cell is stored, and `keep(key, values)`, which
    stores one; its values include "seconds" and "cpu_seconds".
    """

    def fill(
        self: Any,
        keys: Sequence[Any],
        compute: Callable[[Any], Values],
        *,
        executor: str = "local",
        say: Say = print,
    ) -> None:
        """Computes the missing cells, and stores each as soon as it is done.

        Args:
            keys: of all cells.
            compute: returns the values of a key. Dask and Ray send it to their workers.
            executor: "local", one cell after the other in this process; "dask" or "ray", in the
                workers of the cluster that DASK_SCHEDULER_ADDRESS or RAY_ADDRESS names, or else in
                one worker for each core of this machine.
            say: where a line about each cell goes.

        Raises:
            ValueError: an unknown executor, or stored cells do not fit.
            ImportError: Dask or Ray is not installed; `pip install 'cotlearn[machines]'` does it.
        """

        def timed(key: Any) -> tuple[Any, Values]:
            started, cpu = time.perf_counter(), time.process_time()
            values = compute(key)
            seconds = round(time.perf_counter() - started, 1)
            spent = {"seconds": seconds, "cpu_seconds": round(time.process_time() - cpu, 1)}
            return key, {**values, **spent}

        with _opened(executor) as each:
            missing = [key for key in keys if not self.holds(key)]
            say(f"{len(keys)} cells, {len(keys) - len(missing)} done already")
            for number, (key, values) in enumerate(each(timed, missing), start=1):
                self.keep(key, values)
                say(f"[{number}/{len(missing)}] {key}: {values['seconds']:.0f} s")


@contextlib.contextmanager
def _opened(executor: str) -> Iterator[Callable[..., Iterable[Any]]]:
    """A function like `map`; with workers, its results come in the order in which they are done."""
    check_choice(executor, "executor", ("local", "dask", "ray"))
    if executor == "local":
        yield map
    elif executor == "dask":
        from distributed import Client

        with Client(threads_per_worker=1, dashboard_address=None) as client:
            yield partial(_each, client.get_executor().submit)
    else:
        import ray

        with ray.init():
            yield partial(_each, lambda f, key: ray.remote(f).remote(key).future())


def _each(submit: Callable[..., Future[Any]], f: Callable[[Any], Any], keys: Any) -> Iterator[Any]:
    """The results of f(key) in the order in which they are done."""
    return (done.result() for done in as_completed([submit(f, key) for key in keys]))


class Table(Store):
    """A store of cells in one JSON file.

    Args:
        path: the file; the cells in it are not computed again.
        question: the question that the table answers, one sentence.
        command: the shell command that computes the table.
        protocol: the settings shared by all cells; JSON-compatible.

    Raises:
        ValueError: the file is damaged or was made with another protocol.
    """

    def __init__(self, path: Path, *, question: str, command: str, protocol: Values) -> None:
        self.path = path
        protocol = json.loads(json.dumps(protocol))  # as it will be read back
        stored = read_json(path) if path.exists() else {"protocol": protocol, "cells": []}
        if stored["protocol"] != protocol:
            raise ValueError(f"{path} was made with another protocol: give another file")
        self.document: Values = {
            "question": question,
            "command": command,
            "protocol": protocol,
            **machine("POT"),
            "cells": stored["cells"],
        }

    def holds(self, key: Values) -> bool:
        """Whether a cell with this key is in the file."""
        return any(cell["key"] == key for cell in self.document["cells"])

    def keep(self, key: Values, values: Values) -> None:
        """Adds a cell to the file."""
        self.document["cells"].append({"key": key, **values})
        self.write()

    def write(self) -> None:
        """Writes the file."""
        for total in ("seconds", "cpu_seconds"):
            self.document[total] = round(sum(cell[total] for cell in self.document["cells"]))
        write_json(self.path, self.document)


class Folder(Store):
    """A store with one JSON file per cell, so that several processes can run in parallel.

    Args:
        path: the folder.
        protocol: the settings shared by all cells, as JSON returns them.
        read: converts a stored protocol before it is compared, for instance from old names.
    """

    def __init__(
        self, path: Path, protocol: Values, *, read: Callable[[Values], Values] = dict
    ) -> None:
        self.path, self.protocol, self.read = path, protocol, read

    def holds(self, key: str) -> bool:
        """Whether there is a file for this key.

        Raises:
            ValueError: the file is damaged or was made with another protocol.
        """
        file = self.path / f"{key}.json"
        if not file.is_file():
            return False
        stored = self.read(read_json(file, "protocol")["protocol"])
        other = sorted(k for k in self.protocol if stored.get(k) != self.protocol[k])
        if other:
            raise ValueError(f"{file} was made with another protocol ({', '.join(other)})")
        return True

    def keep(self, key: str, values: Values) -> None:
        """Writes the file of a cell."""
        write_json(self.path / f"{key}.json", {"protocol": self.protocol, **values})
