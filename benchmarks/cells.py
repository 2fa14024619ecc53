"""A table of results that is written cell by cell, so that an interrupted run can go on."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch

from cotlearn.storage import atomic_path

RESULTS = Path(__file__).resolve().parents[1] / "data" / "results"
Key = dict[str, Any]


class Table:
    """Cells in a JSON file, each with its key, its values and its seconds.

    Args:
        path: the file; cells that it holds already are not computed again.
        question: what the table answers, one sentence.
        protocol: everything that all cells share; JSON-compatible.

    Raises:
        ValueError: the file holds cells of another protocol.
    """

    def __init__(self, path: Path, *, question: str, protocol: dict[str, Any]) -> None:
        self.path = path
        protocol = json.loads(json.dumps(protocol))  # as it will be read back
        self.document: dict[str, Any] = {
            "question": question,
            "command": shlex.join(
                ["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]]
            ),
            "protocol": protocol,
            "versions": {
                "python": platform.python_version(),
                **{n: importlib.metadata.version(n) for n in ("torch", "numpy", "scipy", "POT")},
            },
            "machine": f"one of {os.cpu_count()} CPU cores of a shared server, "
            f"{platform.machine()}, {torch.get_num_threads()} thread",
            "cells": [],
        }
        if path.exists():
            stored = json.loads(path.read_text(encoding="utf-8"))
            if stored["protocol"] != protocol:
                raise ValueError(f"{path.name} was made with another protocol: use --output")
            self.document["cells"] = stored["cells"]

    def fill(self, keys: Iterable[Key], compute: Callable[[Key], dict[str, Any]]) -> None:
        """Compute the cells that are missing, one after the other, each stored at once."""
        keys = list(keys)
        stored = [cell["key"] for cell in self.document["cells"]]
        missing = [key for key in keys if key not in stored]
        print(f"{len(keys)} cells, {len(keys) - len(missing)} stored already", flush=True)
        began = time.perf_counter()
        for number, key in enumerate(missing, start=1):
            started, cpu = time.perf_counter(), time.process_time()
            values = compute(key)
            seconds = time.perf_counter() - started
            cell = {
                "key": key,
                **values,
                "seconds": round(seconds, 1),
                "cpu_seconds": round(time.process_time() - cpu, 1),
            }
            self.document["cells"].append(cell)
            self.write()
            left = (time.perf_counter() - began) / number * (len(missing) - number)
            words = " ".join(str(value) for value in key.values())
            print(
                f"[{number}/{len(missing)}] {words}: {seconds:.0f} s; about {left / 60:.0f} min "
                f"left; {json.dumps(values)[:110]}",
                flush=True,
            )

    def write(self) -> None:
        """Write the file atomically, innermost lists of numbers on one line."""
        for total in ("seconds", "cpu_seconds"):
            self.document[total] = round(sum(cell[total] for cell in self.document["cells"]))
        text = json.dumps(self.document, indent=1, allow_nan=False)
        text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
        with atomic_path(self.path) as part:
            part.write_text(text + "\n", encoding="utf-8")
