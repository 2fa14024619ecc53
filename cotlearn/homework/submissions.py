"""Reads a learner's notebook and takes out of it what one answer needs.

An answer is run with the cells that define the names it uses, and with no others: a cell that
plays around, fails or never ends costs nothing unless an answer needs it.
"""

from __future__ import annotations

import ast
import builtins
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

_NAME = re.compile(r"\b(\d\d|hw\d)\.[a-z]")
_FILE = re.compile(r"(?<![A-Za-z0-9])(hw\d|\d\d(?=_))")
#: Cell magics that run their cell as Python.
_TRANSPARENT = ("%%time", "%%timeit", "%%capture", "%%prun")


@dataclass(frozen=True)
class Cell:
    """A code cell.

    Attributes:
        number: among all cells, counted from 1 as a reader would.
        source: without the lines that only IPython understands.
        question: the question that the cell was made to answer, if it still says so.
        tags: of the cell.
        error: where its syntax is wrong, in words.
        binds: names that it defines when it is run.
        uses: names that it needs from elsewhere.
    """

    number: int
    source: str
    question: str | None = None
    tags: tuple[str, ...] = ()
    error: str | None = None
    binds: frozenset[str] = field(default=frozenset())
    uses: frozenset[str] = field(default=frozenset())


@dataclass(frozen=True)
class Submission:
    """A notebook that was read.

    Attributes:
        path: of the file.
        assignment: "hw1", "01", ..., or None if nothing in the notebook tells.
        version: of cotlearn that the notebook was made with, if it is stamped.
        cells: the code cells.
    """

    path: Path
    assignment: str | None
    version: str | None
    cells: tuple[Cell, ...]

    def defining(self, name: str) -> Cell | None:
        """Returns the last cell that defines a name."""
        return next((cell for cell in reversed(self.cells) if name in cell.binds), None)

    def needed(self, names: set[str]) -> list[Cell]:
        """Returns the cells that define these names, and what those cells need, in order."""
        chosen: dict[int, Cell] = {}
        wanted = [(name, len(self.cells)) for name in sorted(names)]
        seen = set(wanted)
        while wanted:
            name, place = wanted.pop()
            found = self._before(name, place)
            if found is None or found in chosen:
                continue
            cell = chosen[found] = self.cells[found]
            more = {(use, found) for use in cell.uses} - seen
            seen |= more
            wanted += sorted(more)
        return [chosen[index] for index in sorted(chosen)]

    def _before(self, name: str, place: int) -> int | None:
        """The last cell before `place` that defines the name, else the first after it."""
        places = [i for i, cell in enumerate(self.cells) if name in cell.binds]
        before = [i for i in places if i < place]
        return before[-1] if before else places[0] if places else None


def read(path: Path) -> Submission:
    """Reads a notebook.

    Args:
        path: An `.ipynb` file of Python.

    Raises:
        ValueError: It is missing, no notebook, or of another language; the message is for the
            learner.
    """
    notebook = read_notebook(path)
    language = _language(notebook)
    if language != "python":
        raise ValueError(
            f"{path.name} runs with a kernel for {language}; choose the kernel Python 3 "
            "(menu Kernel, Change Kernel), run it again and save it"
        )
    cells = tuple(
        parse_cell(i, cell)
        for i, cell in enumerate(notebook.cells, start=1)
        if cell.cell_type == "code"
    )
    stamp = notebook.metadata.get("cotlearn", {})
    stamp = stamp if isinstance(stamp, dict) else {}
    return Submission(
        path=path,
        assignment=_assignment(path, stamp, cells),
        version=str(stamp["version"]) if "version" in stamp else None,
        cells=cells,
    )


def read_notebook(path: Path) -> Any:
    """Reads a file as a notebook of format 4.

    Raises:
        ValueError: It is missing or is no notebook.
        ModuleNotFoundError: nbformat is not installed.
    """
    import nbformat

    try:
        notebook = nbformat.read(path, as_version=4)
    except FileNotFoundError:
        raise ValueError(f"there is no file {path}") from None
    except OSError as error:
        raise ValueError(f"{path.name} cannot be read: {error.strerror}") from None
    except Exception:  # nbformat fails in many ways on what is no notebook
        raise ValueError(
            f"{path.name} is not a notebook that can be read: it is empty or damaged, or another "
            "kind of file with this name"
        ) from None
    if not isinstance(notebook.get("cells"), list):
        raise ValueError(f"{path.name} is not a notebook that can be read: it has no cells")
    return notebook


def parse_cell(number: int, cell: Any) -> Cell:
    """Finds what a code cell defines and what it uses."""
    source = python_only(str(cell.source))
    stamp = cell.metadata.get("cotlearn", {})
    question = stamp.get("question") if isinstance(stamp, dict) else None
    tags = tuple(str(tag) for tag in cell.metadata.get("tags", []))
    try:
        tree = ast.parse(source)
    except (SyntaxError, ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        words = str(getattr(error, "msg", None) or error)
        where = f"line {line}: {words}" if line else words
        return Cell(number, source, question, tags, error=where)
    binds = _bound(tree)
    uses = _used(tree)
    return Cell(number, source, question, tags, None, frozenset(binds), frozenset(uses))


def python_only(source: str) -> str:
    """Returns a cell's source with the lines of IPython made empty, so that lines keep their place.

    A cell of another language (`%%bash`) becomes empty as a whole.
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
    return set(_used(ast.parse(expression)))


def _bound(tree: ast.AST) -> set[str]:
    """The names that running a module binds: nothing inside of functions and classes."""
    names: set[str] = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
            continue
        if isinstance(node, ast.Lambda | ast.ListComp | ast.SetComp | ast.DictComp):
            continue
        if isinstance(node, ast.alias):
            names.add(node.asname or node.name.split(".")[0])
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        names |= _bound(node)
    return names


def _used(tree: ast.AST) -> set[str]:
    loads = {
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load)
    }
    return loads - set(dir(builtins))


def _language(notebook: Any) -> str:
    metadata = notebook.metadata
    for key, name in (("kernelspec", "language"), ("language_info", "name")):
        part = metadata.get(key, {})
        if isinstance(part, dict) and part.get(name):
            return str(part[name]).lower()
    return "python"


def _assignment(path: Path, stamp: dict[str, Any], cells: tuple[Cell, ...]) -> str | None:
    if isinstance(stamp.get("assignment"), str):
        return str(stamp["assignment"])
    for cell in cells:
        called = "check(" in cell.source and _NAME.search(cell.source)
        if called:
            return called[1]
    named = _FILE.search(path.stem.lower())
    return named[1] if named else None
