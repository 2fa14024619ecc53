"""Results on disk: cells that are computed once, with the versions and the machine beside them."""

import importlib.metadata
import json
import os
import platform
import re
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch

from cotlearn.files import write_text

Values = dict[str, Any]
Say = Callable[[str], None]


def machine(*packages: str) -> Values:
    """Versions of Python, torch, numpy, scipy and other packages, and the hardware."""
    names = ("torch", "numpy", "scipy", *packages)
    versions = {name: importlib.metadata.version(name) for name in names}
    return {
        "versions": {"python": platform.python_version(), **versions},
        "machine": f"one of {os.cpu_count()} CPU cores of a shared server, {platform.machine()}, "
        f"{torch.get_num_threads()} thread",
    }


def write_json(path: Path, value: Any) -> None:
    """Writes a file atomically, innermost lists of numbers on one line."""
    text = json.dumps(value, indent=1, allow_nan=False)
    text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    write_text(path, text + "\n")


def read_json(path: Path, *keys: str) -> Values:
    """Reads what `write_json` wrote; the keys must be there.

    Raises:
        ValueError: the file is damaged, or holds something else.
    """
    try:
        found: Values = json.loads(path.read_text(encoding="utf-8"))
        if missing := [key for key in keys if key not in found]:
            raise ValueError(f"it has no {missing[0]}")
    except ValueError as error:
        raise ValueError(f"{path} is damaged: delete it to make it again ({error})") from error
    return found


class Store:
    """Cells that are computed one after the other; an interrupted run goes on where it stopped.

    A kind of store has `holds(key)`, whether a cell is there, and `keep(key, values)`, which writes
    one, with "seconds" and "cpu_seconds" among its values.
    """

    def fill(
        self: Any, keys: Sequence[Any], compute: Callable[[Any], Values], *, say: Say = print
    ) -> None:
        """Computes the cells that are missing, each stored at once."""
        missing = [key for key in keys if not self.holds(key)]
        say(f"{len(keys)} cells, {len(keys) - len(missing)} done already")
        for number, key in enumerate(missing, start=1):
            started, cpu = time.perf_counter(), time.process_time()
            values = compute(key)
            seconds = round(time.perf_counter() - started, 1)
            spent = {"seconds": seconds, "cpu_seconds": round(time.process_time() - cpu, 1)}
            self.keep(key, {**values, **spent})
            say(f"[{number}/{len(missing)}] {key}: {seconds:.0f} s")


class Table(Store):
    """Cells in one JSON file, each with its key.

    Args:
        path: the file; cells that it holds already are not computed again.
        question: what the table answers, one sentence.
        command: that makes it.
        protocol: everything that all cells share; JSON-compatible.

    Raises:
        ValueError: the file is damaged, or holds cells of another protocol.
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
        """Whether a cell of this key is in the file."""
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
    """One JSON file for each cell, so that several runs can work side by side.

    Args:
        path: the folder.
        protocol: of all cells, as JSON gives it back.
        read: makes a stored protocol comparable to it: old names, for instance.
    """

    def __init__(
        self, path: Path, protocol: Values, *, read: Callable[[Values], Values] = dict
    ) -> None:
        self.path, self.protocol, self.read = path, protocol, read

    def holds(self, key: str) -> bool:
        """Whether there is a file of this protocol.

        Raises:
            ValueError: the file is damaged, or of another protocol.
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
        """Writes the file."""
        write_json(self.path / f"{key}.json", {"protocol": self.protocol, **values})
