"""Results on disk: tidy tables in CSV files that say what made them."""

import csv
import importlib.metadata
import io
import json
import math
import os
import platform
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from filelock import FileLock

from cotlearn.course.assets import find_data
from cotlearn.files import write_text

Values = dict[str, Any]
Say = Callable[[str], None]

#: The last columns of a table: what a cell took, by the clock and of the CPU.
SPENT = ("seconds", "cpu_seconds")


def read_table(name: str) -> Any:
    """Reads a table of the course.

    Args:
        name: of a file in `data/results/`, without ".csv".

    Returns:
        A `pandas.DataFrame`, one row a measurement. Its `attrs` say what made it: "question",
        "command", "protocol", "versions", "machine", and the "cpu_seconds" of all cells.

    Raises:
        ValueError: there is no such file.
    """
    return _frame(find_data(f"results/{name}.csv"))


def _frame(path: Path) -> Any:
    """The rows of a file, and in `attrs` what made them."""
    import pandas

    frame = pandas.read_csv(path, comment="#", keep_default_na=False, na_values=[""])
    frame.attrs = _about(path.read_text(encoding="utf-8"))
    return frame


class Table:
    """Rows in one CSV file, computed cell by cell; a stopped run goes on where it was.

    The first lines begin with `#`. They keep what made the table, for instance the `protocol`, as
    JSON. Then come the rows. A *cell* is what is computed for one key: one row or several.

    Args:
        path: the file; the cells in it are not computed again.
        question: the question that the table answers, one sentence.
        command: the shell command that computes the table.
        protocol: the settings shared by all cells; JSON-compatible.
        axis: what the numbers in `{"error": {1: 0.5, 16: 0.1}}` are, for instance "nfe": they get
            a row each. Two names with a space between for numbers within numbers.

    Raises:
        ValueError: the file is damaged or was made with another protocol.
    """

    def __init__(
        self, path: Path, *, question: str, command: str, protocol: Values, axis: str = ""
    ) -> None:
        self.path, self.axes = path, axis.split()
        self.rows: list[dict[str, str]] = []
        protocol = json.loads(json.dumps(protocol))  # as it will be read back
        self.about: Values = {"question": question, "command": command, "protocol": protocol}
        self.about |= {**machine("POT"), "cpu_seconds": 0}
        if path.exists():
            stored, self.rows = self._stored()
            self.about["cpu_seconds"] = stored["cpu_seconds"]

    def _stored(self) -> tuple[Values, list[dict[str, str]]]:
        """What made the file, and its rows."""
        stored, rows = _read(self.path)
        if stored["protocol"] != self.about["protocol"]:
            raise ValueError(f"{self.path} was made with another protocol: give another file")
        return stored, rows

    def fill(
        self,
        keys: Sequence[Values],
        compute: Callable[[Any], Values | list[Values]],
        *,
        say: Say = print,
    ) -> None:
        """Computes the missing cells, and stores each as soon as it is done.

        Args:
            keys: of all cells, with the same names in each: the first columns.
            compute: returns the values of a key: numbers, words, truth values, None, and
                dictionaries of these, `{"skew": {"mean": 0.1}}` for a column `skew_mean`; or a list
                of such dictionaries, one for each row.
            say: where a line about each cell goes.
        """
        keys = [key for i, key in enumerate(keys) if key not in keys[:i]]
        missing = [key for key in keys if not self.holds(key)]
        say(f"{len(keys)} cells, {len(keys) - len(missing)} done already")
        for number, key in enumerate(missing, start=1):
            started, cpu = time.perf_counter(), time.process_time()
            values = compute(key)
            seconds = round(time.perf_counter() - started, 1)
            self.keep(key, values, seconds, round(time.process_time() - cpu, 1))
            say(f"[{number}/{len(missing)}] {key}: {seconds:.0f} s")

    def holds(self, key: Values) -> bool:
        """Whether a cell with this key is in the file."""
        words = _words(key).items()
        return any(words <= row.items() for row in self.rows)

    def keep(
        self, key: Values, values: Values | list[Values], seconds: float, cpu_seconds: float
    ) -> None:
        """Adds a cell to the file.

        Raises:
            ValueError: a value is no number, word or truth value, or not finite; a word reads as a
                number; numbers have no axis; a name is in the key, or occurs twice.
        """
        first = key | dict.fromkeys(self.axes)
        last = {"seconds": seconds, "cpu_seconds": cpu_seconds}
        cells = values if isinstance(values, list) else [values]
        rows = [row for each in cells for row in _melted(each, self.axes)]
        if taken := {name for row in rows for name in row if name in {*key, *SPENT}}:
            raise ValueError(f"compute must not return {min(taken)!r}, which is in the key or time")
        rows = [_words(first | row | last) for row in rows]
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with FileLock(self.path.with_name(f".{self.path.name}.lock")):
            if self.path.exists():  # another process may have added cells
                stored, self.rows = self._stored()
                self.about["cpu_seconds"] = stored["cpu_seconds"]
            if self.holds(key):  # it has computed this one, too
                return
            self.rows = [*self.rows, *rows]
            self.about["cpu_seconds"] = round(self.about["cpu_seconds"] + cpu_seconds, 1)
            self.write()

    def frame(self) -> Any:
        """The rows as a `pandas.DataFrame`, see `read_table`."""
        return _frame(self.path)

    def write(self) -> None:
        """Writes the file."""
        text = io.StringIO()
        for name, value in self.about.items():
            text.write(f"# {name}: {json.dumps(value, ensure_ascii=False, allow_nan=False)}\n")
        columns = dict.fromkeys(name for row in self.rows for name in row if name not in SPENT)
        writer = csv.DictWriter(text, [*columns, *SPENT], restval="", lineterminator="\n")
        writer.writeheader()
        writer.writerows(self.rows)
        write_text(self.path, text.getvalue())


def _melted(values: Values, axes: Sequence[str]) -> list[Values]:
    """The rows of nested dictionaries: words become names of columns, numbers those of rows."""
    shared: Values = {}
    rows: dict[tuple[Any, ...], Values] = {}
    for path, value in _leaves(values):
        numbers = tuple(part for part in path if not isinstance(part, str))
        name = "_".join(part for part in path if isinstance(part, str))
        if len(numbers) > len(axes):
            raise ValueError(f"axis must name what the numbers in {name} are, got {numbers}")
        row = (
            rows.setdefault(numbers, dict(zip(axes, numbers, strict=False))) if numbers else shared
        )
        if name in row or (name in axes and numbers):
            raise ValueError(f"compute must not return {name!r} twice")
        row[name] = value
    if twice := {name for row in rows.values() for name in row if name in shared}:
        raise ValueError(f"compute must not return {min(twice)!r} twice")
    return [row | shared for row in rows.values()] or [shared]


def _leaves(values: Mapping[Any, Any], path: tuple[Any, ...] = ()) -> Iterator[Any]:
    for name, value in values.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*path, name))
        else:
            yield (*path, name), value


def _words(row: Values) -> dict[str, str]:
    """A row as it is written."""
    words = {}
    for name, value in row.items():
        if not isinstance(value, str | int | float | None):
            raise ValueError(f"{name} must be a number, a word or a truth value; got {value!r}")
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError(f"{name} must be finite; got {value}")
        words[name] = "" if value is None else str(value)
        if isinstance(value, str) and _reads_as_number(value):
            raise ValueError(f"{name} must not be a word that reads as a number; got {value!r}")
        if "#" in words[name]:
            raise ValueError(f"{name} must not contain #, which begins a comment; got {value!r}")
        if len(f"{words[name]}.".splitlines()) > 1:
            raise ValueError(f"{name} must be one line; got {value!r}")
    return words


def _reads_as_number(word: str) -> bool:
    if word.lower().lstrip("+-") in ("true", "false", "inf", "infinity"):
        return True
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _read(path: Path) -> tuple[Values, list[dict[str, str]]]:
    """What made a table, and its rows."""
    text = path.read_text(encoding="utf-8")
    try:
        about = _about(text)
        lines = [line for line in text.splitlines() if not line.startswith("#")]
        rows = list(csv.DictReader(lines))
        if missing := {"protocol", "cpu_seconds"} - about.keys():
            raise ValueError(f"it has no {min(missing)}")
        if not text.endswith("\n") or any(None in (*row, *row.values()) for row in rows):
            raise ValueError("a row is not whole")
    except (ValueError, RecursionError) as error:  # JSON may be too deep
        raise ValueError(f"{path} is damaged: delete it to make it again ({error})") from error
    return about, rows


def _about(text: str) -> Values:
    """The lines of a table that begin with #."""
    lines = (line[2:].split(": ", 1) for line in text.splitlines() if line.startswith("# "))
    return {name: json.loads(value) for name, value in lines}


def machine(*packages: str) -> Values:
    """Versions of Python, torch, numpy, scipy and `packages`, and a description of the hardware."""
    names = ("torch", "numpy", "scipy", *packages)
    versions = {name: importlib.metadata.version(name) for name in names}
    versions = {"python": platform.python_version(), **versions}
    core = f"one of {os.cpu_count()} cores of a shared server, {processor()}"
    return {"versions": versions, "machine": f"{core}, {torch.get_num_threads()} thread"}


def processor() -> str:
    """The processor's name and architecture: speeds of one say little about another."""
    found = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")  # Linux, where `platform` knows no name
    if cpuinfo.is_file():
        models = re.findall(r"^model name\s*: (.+)$", cpuinfo.read_text(), re.MULTILINE)
        found = models[0] if models else found
    return f"{found or 'unknown'}, {platform.machine()}"
