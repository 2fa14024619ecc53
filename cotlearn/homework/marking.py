"""Marks one notebook: every question in its own process, with a sentence about each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cotlearn
from cotlearn.homework import isolation, submissions
from cotlearn.homework.assignments import Assignment, Question, find
from cotlearn.homework.isolation import Limits
from cotlearn.homework.registry import Verdict
from cotlearn.homework.submissions import Cell, Submission


@dataclass(frozen=True)
class Mark:
    """What was found about one answer.

    Attributes:
        question: its name.
        verdict: of the self-check: "correct", "not yet" or "not attempted yet".
        sentence: that goes with it.
        points: earned in the hidden tests.
        out_of: that could be earned.
        hints: of the hidden tests that failed.
    """

    question: str
    verdict: str
    sentence: str
    points: float
    out_of: float
    hints: tuple[str, ...] = ()

    @property
    def correct(self) -> bool:
        """Whether the self-check is content and no hidden test failed."""
        return self.verdict == Verdict.CORRECT.value and not self.hints


@dataclass(frozen=True)
class Marked:
    """What was found about a notebook.

    Attributes:
        assignment: "hw1"; "" if that could not be told.
        title: of the assignment.
        marks: one a question.
        note: what is wrong with the notebook as a whole; "" if nothing is.
    """

    assignment: str
    title: str
    marks: tuple[Mark, ...]
    note: str = ""

    @property
    def points(self) -> float:
        """Earned, in all."""
        return sum(mark.points for mark in self.marks)

    @property
    def out_of(self) -> float:
        """What could be earned."""
        return sum(mark.out_of for mark in self.marks)

    def to_json(self) -> dict[str, Any]:
        """Returns all of it, JSON-compatible."""
        return asdict(self)

    @classmethod
    def from_json(cls, stored: dict[str, Any]) -> Marked:
        """Reads what `to_json` gave.

        Raises:
            KeyError: A part is missing.
            TypeError: A part is of another kind.
        """
        marks = (Mark(**{**item, "hints": tuple(item["hints"])}) for item in stored["marks"])
        return cls(stored["assignment"], stored["title"], tuple(marks), stored["note"])


def mark(
    path: Path,
    *,
    hidden: bool = False,
    masters: Path | None = None,
    limits: Limits | None = None,
    each: Callable[[Mark], None] | None = None,
) -> Marked:
    """Marks a notebook.

    Args:
        path: The learner's notebook; it is read, not changed and not run as a whole.
        hidden: Run the hidden tests, too, for points.
        masters: The folder of the master notebooks; those of the course if None.
        limits: On each question.
        each: Called with every mark as it is found.

    Raises:
        ValueError: The file is no notebook, or belongs to no assignment.
    """
    submission = submissions.read(path)
    if submission.assignment is None:
        raise ValueError(
            f"{path.name} belongs to no assignment: no cell of it calls check(...), and its name "
            "says nothing like hw1; start from a fresh copy of the assignment"
        )
    assignment = find(submission.assignment, masters)
    marks = []
    for question in assignment.questions:
        found = mark_question(submission, question, assignment, hidden=hidden, limits=limits)
        marks.append(found)
        if each is not None:
            each(found)
    return Marked(assignment.name, assignment.title, tuple(marks), _stamp(submission))


def mark_question(
    submission: Submission,
    question: Question,
    assignment: Assignment,
    *,
    hidden: bool = False,
    limits: Limits | None = None,
) -> Mark:
    """Marks one answer of a notebook; arguments as for `mark`."""
    tests = question.tests if hidden else ()
    out_of = sum(test.points for test in tests)
    names = submissions.names_in(question.answer)
    missing = sorted(name for name in names if submission.defining(name) is None)
    if missing:
        sentence = _missing(submission, question, missing[0])
        return Mark(question.name, Verdict.NOT_YET.value, sentence, 0, out_of)
    own = submission.defining(sorted(names)[0])
    assert own is not None
    outcome = isolation.run(
        {
            "setup": assignment.setup,
            "cells": [
                {"number": cell.number, "source": cell.source} for cell in submission.needed(names)
            ],
            "own": own.number,
            "answer": question.answer,
            "name": question.name,
            "tests": [{"source": test.source, "hint": test.hint} for test in tests],
        },
        limits or Limits(),
    )
    return _from_messages(question, outcome, hidden=hidden)


def _from_messages(question: Question, outcome: isolation.Outcome, *, hidden: bool) -> Mark:
    verdict, sentence = Verdict.NOT_YET.value, outcome.problem or ""
    points, hints = 0.0, []
    tests = question.tests if hidden else ()
    done = 0
    for message in outcome.messages:
        if "verdict" in message:
            verdict, sentence = message["verdict"], message["sentence"]
        elif message.get("test") == done and done < len(tests):
            if message["passed"]:
                points += tests[done].points
            else:
                hints.append(message["sentence"])
            done += 1
    attempted = verdict != Verdict.NOT_ATTEMPTED.value
    if outcome.problem is not None and done < len(tests):
        hints.append(outcome.problem)
    return Mark(
        question.name,
        verdict,
        sentence,
        points,
        sum(test.points for test in tests),
        tuple(dict.fromkeys(hints)) if attempted else (),
    )


def _missing(submission: Submission, question: Question, name: str) -> str:
    """Why there is no answer of this name, as far as the notebook tells."""
    broken = next(
        (
            cell
            for cell in submission.cells
            if cell.error and (cell.question == question.name or _mentions(cell, name))
        ),
        None,
    )
    if broken is not None:
        return f"cell {broken.number} is not Python that can be read: {broken.error}"
    own = next((cell for cell in submission.cells if cell.question == question.name), None)
    if own is not None and own.binds:
        return (
            f"the answer must be called {name}, and your cell defines "
            f"{' and '.join(sorted(own.binds))}: give it its name back"
        )
    return (
        f"there is no {name} in this notebook: its cell was deleted, emptied or renamed; take it "
        "again from a fresh copy"
    )


def _mentions(cell: Cell, name: str) -> bool:
    return f"def {name}(" in cell.source or f"{name} =" in cell.source


def _stamp(submission: Submission) -> str:
    """A word where the notebook was made for another minor version of cotlearn."""
    if submission.version is None:
        return ""
    made, here = (".".join(text.split(".")[:2]) for text in (submission.version, _version()))
    if made == here:
        return ""
    return f"made with cotlearn {submission.version}, marked with {_version()}"


def _version() -> str:
    return str(cotlearn.__version__)
