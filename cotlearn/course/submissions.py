"""Reads a hand-in: its code cells, and to which assignment it belongs; where its page goes."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cotlearn.course.assignments import Question
from cotlearn.files import check_output

MOST_BYTES = 20_000_000  #: of a notebook; figures in the course's take less than 1
_NAME = re.compile(r"\b(\d\d|hw\d)\.[a-z]")
_FILE = re.compile(r"(?<![A-Za-z0-9])(hw\d|\d\d(?=_))")


@dataclass(frozen=True)
class Cell:
    """A code cell.

    Attributes:
        number: position among all cells, counted from 1.
        source: as written, IPython's lines included.
        plain: whether it imports, answers an exercise or checks one, which takes no time.
    """

    number: int
    source: str
    plain: bool = False

    def is_of(self, question: Question) -> bool:
        """Whether it defines the answer to a question, or checks it."""
        return self.defines(question) or ("check(" in self.source and question.name in self.source)

    def defines(self, question: Question) -> bool:
        """Whether it defines the answer to a question."""
        name = question.answer
        return f"def {name}(" in self.source or f"{name} = " in self.source


@dataclass(frozen=True)
class Submission:
    """A notebook that was read.

    Attributes:
        assignment: "hw1", "01", ...
        version: version of cotlearn that made the notebook; "" without a stamp.
        cells: the code cells.
    """

    assignment: str
    version: str
    cells: list[Cell]


def read(path: Path) -> Submission:
    """Reads a notebook.

    Args:
        path: An `.ipynb` file of Python.

    Raises:
        ValueError: The file is missing, too large, not a notebook, not in Python or of no
            assignment; the message is for the learner.
    """
    from cotlearn.course import execution  # needs Jupyter's packages

    if path.suffix.lower() != ".ipynb":
        raise ValueError(f"{path.name} is not a notebook; hand in the notebook (.ipynb)")
    if path.is_symlink() or (path.exists() and not path.is_file()):
        raise ValueError(f"{path.name} is not a notebook: it is a folder, a link or a device")
    if path.exists() and path.stat().st_size > MOST_BYTES:
        size = f"{path.stat().st_size / 1e6:,.0f} MB, and {MOST_BYTES / 1e6:.0f} are the most"
        raise ValueError(f"{path.name} is too large: {size}; clear its outputs and save it again")
    notebook = execution.read(path)
    try:
        return _taken_apart(path, notebook)
    except (AttributeError, KeyError, TypeError) as error:  # fields that are not what they were
        raise ValueError(f"{path.name} is not a readable notebook: {error}") from None


def pages_of(folder: Path, out: Path) -> Path:
    """Returns the folder of the students' pages, which has the name of the table without ".csv".

    Args:
        folder: The folder of the hand-ins.
        out: The table.

    Raises:
        ValueError: Its name does not end in ".csv", it cannot be written, or the pages would lie
            among the hand-ins.
    """
    if out.is_dir() or out.suffix.lower() != ".csv":
        raise ValueError(f"out must be a file such as grades.csv, a table in CSV, got {out}")
    pages = out.with_suffix("")
    handed_in = folder.resolve()
    if pages.resolve() in (handed_in, *handed_in.parents):
        why = f"the pages of the students go to the folder {pages}, where the hand-ins are"
        raise ValueError(f"out must have another name than the folder {pages}, got {out}: {why}")
    if handed_in in pages.resolve().parents:
        other = handed_in.parent / out.name
        raise ValueError(f"out must lie outside the folder of the hand-ins, as {other}, got {out}")
    check_output(pages / "page", "out")
    return pages


def _taken_apart(path: Path, notebook: Any) -> Submission:
    kernel = notebook.metadata.get("kernelspec") or {}  # some editors write null
    language = str(kernel.get("language") or "python").lower()
    if language != "python":
        remedy = "choose the kernel Python 3 (menu Kernel, Change Kernel), run it again and save it"
        raise ValueError(f"{path.name} runs with a kernel for {language}; {remedy}")
    cells = [
        Cell(number, cell.source, _plain(cell))
        for number, cell in enumerate(notebook.cells, start=1)
        if cell.cell_type == "code"
    ]
    from cotlearn.course import execution

    if execution.title(notebook).startswith("Extra "):  # its number is that of a lesson, too
        raise ValueError(
            f"{path.name} is an extra, whose own cells judge its answers: run them; nothing is "
            "checked from outside"
        )
    stamp = notebook.metadata.get("cotlearn") or {}
    assignment = stamp.get("assignment") or _assignment(path, cells)
    if assignment is None and any("import challenge" in cell.source for cell in cells):
        remedy = "cotlearn challenge FILE scores the Python file that defines your coupling"
        raise ValueError(f"{path.name} has no exercises to check; {remedy}")
    if assignment is None:
        why = "no cell calls check(...), and its name says nothing like hw1; take a fresh copy"
        raise ValueError(f"{path.name} belongs to no assignment: {why}")
    return Submission(str(assignment), str(stamp.get("version", "")), cells)


def _plain(cell: Any) -> bool:
    tagged = set(cell.metadata.get("tags", [])) & {"exercise", "check"}
    return bool(tagged) or cell.source.startswith(("import ", "from ", "check("))


def _assignment(path: Path, cells: list[Cell]) -> str | None:
    checks = (_NAME.search(cell.source) for cell in cells if "check(" in cell.source)
    found = next(filter(None, checks), None) or _FILE.search(path.stem.lower())
    room = "laboratory/" if path.parent.name == "laboratory" else ""
    return room + found[1] if found else None
