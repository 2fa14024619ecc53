"""Reads a learner's notebook and extracts the cells that one answer needs.

An answer runs only with the cells that define the names it uses. A cell that fails or never ends
does no harm unless an answer needs it.
"""

import builtins
import os
import re
import stat
import symtable
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

_NAME = re.compile(r"\b(\d\d|hw\d)\.[a-z]")
_FILE = re.compile(r"(?<![A-Za-z0-9])(hw\d|\d\d(?=_))")
MOST_BYTES = 20_000_000  #: of a notebook; figures in the course's take less than 1
MOST_CODE = 1_000_000  #: characters in all code cells; Python needs 200 bytes to read one
MOST_CELLS = 2_000
#: What a student may hand in instead of a notebook, by the end of its name.
_OTHERS = {
    ".py": "a Python file; hand in the notebook (.ipynb)",
    ".zip": "an archive; unpack it, and grade what is inside",
    ".html": "a web page; hand in the notebook (.ipynb)",
    ".pdf": "a document to read; hand in the notebook (.ipynb)",
    ".ipynb.txt": "a notebook with .txt at the end of its name; take that away",
    ".ipynb.json": "a notebook with .json at the end of its name; take that away",
}
_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFLNK: "a link; hand in the file itself",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
#: Cell magics that run their cell as Python.
_TRANSPARENT = ("%%time", "%%timeit", "%%capture", "%%prun")


@dataclass(frozen=True)
class Cell:
    """A code cell.

    Attributes:
        number: position among all cells, counted from 1.
        source: source code without the lines that only IPython understands.
        question: the question that the cell answers, if its metadata still name it.
        error: description of a syntax error; None if there is none.
        binds: names that the cell defines.
        uses: names that it uses and does not define first.
        written: source code as written, IPython's lines included.
    """

    number: int
    source: str
    question: str | None = None
    error: str | None = None
    binds: frozenset[str] = frozenset()
    uses: frozenset[str] = frozenset()
    written: str = ""

    def checks(self, question: re.Pattern[str]) -> bool:
        """Whether a line calls check(...) with this question."""
        after = (line.partition("check(")[2] for line in self.source.splitlines())
        return any(map(question.search, after))


@dataclass(frozen=True)
class Submission:
    """A notebook that was read.

    Attributes:
        assignment: "hw1", "01", ..., or None if the notebook does not tell.
        version: version of cotlearn that made the notebook; "" without a stamp.
        cells: the code cells.
    """

    assignment: str | None
    version: str
    cells: tuple[Cell, ...]

    def defining(self, name: str, before: int | None = None) -> Cell | None:
        """Returns the last cell that defines a name, if possible above the cell number `before`."""
        found = [cell for cell in self.cells if name in cell.binds]
        earlier = [cell for cell in found if before is None or cell.number < before]
        return earlier[-1] if earlier else next(iter(found), None)

    def needed(self, names: set[str]) -> list[Cell]:
        """Returns, in order, the cells that define these names and all cells that those need."""
        chosen: dict[int, Cell] = {}
        wanted: list[tuple[str, int | None]] = [(name, None) for name in sorted(names)]
        while wanted:
            cell = self.defining(*wanted.pop())
            if cell is not None and cell.number not in chosen:
                chosen[cell.number] = cell
                wanted += [(use, cell.number) for use in sorted(cell.uses)]
        return [chosen[number] for number in sorted(chosen)]

    def until(self, question: str, names: set[str]) -> list[Cell]:
        """Returns all cells down to a question's check and the last definition of the names."""
        name = re.compile(rf"{re.escape(question)}\b")
        ends = [c.number for c in self.cells if c.binds & names or c.checks(name)]
        return [cell for cell in self.cells if not ends or cell.number <= max(ends)]


def examine(path: Path) -> None:
    """Checks the kind and size of a file without opening it.

    Args:
        path: The path of a file that was handed in; links are not followed.

    Raises:
        ValueError: The file cannot be a notebook; the message is for the learner.
    """
    try:
        found = path.lstat()
    except FileNotFoundError:
        raise ValueError(f"there is no notebook at {path}") from None
    except OSError as error:
        raise ValueError(f"{path.name} cannot be read: {error.strerror}") from None
    kind = _KINDS.get(stat.S_IFMT(found.st_mode))
    if kind is None and not path.name.lower().endswith(".ipynb"):
        ends = (what for end, what in _OTHERS.items() if path.name.lower().endswith(end))
        kind = next(ends, "another kind of file; hand in the notebook (.ipynb)")
    if kind is not None:
        raise ValueError(f"{path.name} is not a readable notebook: it is {kind}")
    if found.st_size > MOST_BYTES:
        size = f"{found.st_size / 1e6:,.0f} MB, and {MOST_BYTES / 1e6:.0f} are the most"
        raise ValueError(f"{path.name} is too large: {size}; clear its outputs and save it again")
    if not os.access(path, os.R_OK):
        raise ValueError(f"{path.name} cannot be read: permission denied")


def read(path: Path) -> Submission:
    """Reads a notebook.

    Args:
        path: An `.ipynb` file of Python.

    Raises:
        ValueError: The file is missing, too large, not a notebook or not in Python; the message is
            for the learner.
    """
    from cotlearn.execution import read as read_notebook  # needs Jupyter's packages

    examine(path)
    try:
        return _taken_apart(path, read_notebook(path))
    except (AttributeError, KeyError, TypeError) as error:  # of fields that are not what they were
        raise ValueError(f"{path.name} is not a readable notebook: {error}") from None


def _taken_apart(path: Path, notebook: Any) -> Submission:
    kernel, info = (notebook.metadata.get(key, {}) for key in ("kernelspec", "language_info"))
    language = str(kernel.get("language") or info.get("name") or "python").lower()
    if language != "python":
        remedy = "choose the kernel Python 3 (menu Kernel, Change Kernel), run it again and save it"
        raise ValueError(f"{path.name} runs with a kernel for {language}; {remedy}")
    code = sum(len(cell.source) for cell in notebook.cells if cell.cell_type == "code")
    if code > MOST_CODE or len(notebook.cells) > MOST_CELLS:
        sizes = f"{code:,} characters of code in {len(notebook.cells):,} cells"
        most = f"{MOST_CODE:,} in {MOST_CELLS:,} are the most"
        raise ValueError(f"{path.name} is too large: {sizes}, and {most}")
    numbered = enumerate(notebook.cells, start=1)
    cells = tuple(parse_cell(i, cell) for i, cell in numbered if cell.cell_type == "code")
    stamp = notebook.metadata.get("cotlearn", {})
    return Submission(_assignment(path, stamp, cells), str(stamp.get("version", "")), cells)


def parse_cell(number: int, cell: Any) -> Cell:
    """Parses a code cell and finds the names that it defines and uses."""
    written = str(cell.source)
    source = python_only(written)
    question = cell.metadata.get("cotlearn", {}).get("question")
    try:
        return Cell(number, source, question, None, *_names(source), written)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = getattr(error, "lineno", None)
        words = str(getattr(error, "msg", None) or error)
        words = f"line {line}: {words}" if line else words
        return Cell(number, source, question, words, written=written)


def python_only(source: str) -> str:
    """Returns a cell's source with IPython's lines emptied, so that line numbers stay the same.

    A cell in another language (`%%bash`) becomes empty.
    """
    lines = source.splitlines()
    first = next((line for line in lines if line.strip()), "")
    if first.startswith("%%"):
        if not first.startswith(_TRANSPARENT):
            return ""
        lines[lines.index(first)] = ""
    return "\n".join(_without_magic(line) for line in lines)


def _without_magic(line: str) -> str:
    bare = line.lstrip()
    if re.match(r"(![\w./~]|%[a-zA-Z]+\b(?!\s*=[^=]))", bare):
        return line[: len(line) - len(bare)] + "pass"
    return "" if bare.startswith("?") or re.fullmatch(r"[\w.]+\?{1,2}", bare) else line


def names_in(expression: str) -> set[str]:
    """Returns the names that an expression uses."""
    return set(_names(expression)[1])


def _names(source: str) -> tuple[frozenset[str], frozenset[str]]:
    """The names that a source defines when it runs, and those that it needs from elsewhere."""
    module = symtable.symtable(source, "<cell>", "exec")
    symbols = module.get_symbols()
    binds = (item.get_name() for item in symbols if item.is_assigned() or item.is_imported())
    return frozenset(binds), frozenset(_globals(module)) - set(dir(builtins))


def _globals(table: symtable.SymbolTable) -> Iterator[str]:
    for item in table.get_symbols():
        if item.is_referenced() and (item.is_global() or table.get_type() == "module"):
            yield item.get_name()
    for inner in table.get_children():
        yield from _globals(inner)


def _assignment(path: Path, stamp: dict[str, Any], cells: tuple[Cell, ...]) -> str | None:
    if "assignment" in stamp:
        return str(stamp["assignment"])
    checks = (_NAME.search(cell.source) for cell in cells if "check(" in cell.source)
    found = next(filter(None, checks), None) or _FILE.search(path.stem.lower())
    room = "laboratory/" if path.parent.name == "laboratory" else ""
    return room + found[1] if found else None
