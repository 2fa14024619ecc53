"""Reads assignments from their master notebooks, which are the only source of the questions.

A master has the format of otter-grader: raw cells mark where a question, its solution and its tests
begin and end. The notebooks of the course are read in the same way; their questions are the cells
tagged "check" and have no hidden tests.
"""

import ast
import re
from dataclasses import dataclass
from pathlib import Path

from cotlearn.course import assets

_CONFIG = re.compile(r'""" +# BEGIN TEST CONFIG\n(.*?)""" +# END TEST CONFIG\n', re.DOTALL)
_OPTION = re.compile(r"^(\w+): *(.*)$", re.MULTILINE)


@dataclass(frozen=True)
class HiddenTest:
    """A test that students do not see.

    Attributes:
        source: source code of one function; its arguments are names in the student's notebook.
        points: points for passing.
        hint: message if the test fails.
    """

    source: str
    points: float
    hint: str


@dataclass(frozen=True)
class Question:
    """One question.

    Attributes:
        name: "hw1.euler" or "01.interpolate".
        answer: the expression that is checked, usually the name of a function.
        tests: the hidden tests.
    """

    name: str
    answer: str
    tests: tuple[HiddenTest, ...] = ()

    @property
    def points(self) -> float:
        """The largest possible number of points."""
        return sum(test.points for test in self.tests)


@dataclass(frozen=True)
class Assignment:
    """A homework, or the exercises of a notebook.

    Attributes:
        name: "hw1" or "01".
        title: the first heading.
        questions: the questions, in order.
        path: path of the master.
    """

    name: str
    title: str
    questions: tuple[Question, ...]
    path: Path


def masters(folder: Path | None = None) -> list[Path]:
    """Returns the master notebooks of the homework, in order.

    Args:
        folder: The folder to search; the course's `notebooks/homework` if None.
    """
    folder = folder or assets.course_folder() / "notebooks" / "homework"
    return sorted(path for path in folder.glob("hw*.ipynb") if re.fullmatch(r"hw\d", path.stem))


def find(name: str, folder: Path | None = None) -> Assignment:
    """Reads an assignment.

    Args:
        name: "hw1", or "01" or "laboratory/11" for the exercises in a notebook of the course.
        folder: The folder of the masters; the course's if None.

    Raises:
        ValueError: There is no such assignment.
    """
    known = {path.stem: path for path in masters(folder)}
    known |= {room + p.name[:2]: p for room in ("", "laboratory/") for p in assets.notebooks(room)}
    if name not in known:
        raise ValueError(assets.not_found("assignment", name, sorted(known)))
    return read(known[name], name)


def read(path: Path, name: str) -> Assignment:
    """Reads a master or a notebook of the course.

    Args:
        path: The notebook.
        name: The name of the assignment: "hw1", "01", ...

    Raises:
        ValueError: The notebook cannot be read, or a question has no check.
    """
    from cotlearn.course import execution  # needs Jupyter's packages

    notebook = execution.read(path)
    questions: list[Question] = []
    tests: list[HiddenTest] = []
    for cell in notebook.cells:
        if config := _CONFIG.match(cell.source):
            options = dict(_OPTION.findall(config[1]))
            hint = options.get("failure_message", "").strip("\"' ")
            source, points = cell.source[config.end() :], float(options.get("points", 1))
            tests.append(HiddenTest(source, points, hint))
        elif "check" in cell.metadata.get("tags", []):
            called = _checks(cell.source)
            questions += [Question(item, answer, tuple(tests)) for answer, item in called]
            tests = []
        elif tests and cell.source.startswith("# BEGIN QUESTION"):
            break
    if tests:
        raise ValueError(f"{path.name}: a question has no cell tagged 'check'")
    return Assignment(name, execution.title(notebook), tuple(questions), path)


def _checks(source: str) -> list[tuple[str, str]]:
    """The pairs (answer, name) of the calls check(answer, "name") in a cell."""
    calls = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Call))
    given = (call.args for call in calls if ast.unparse(call.func) == "check")
    return [(ast.unparse(answer), str(ast.literal_eval(name))) for answer, name in given]
