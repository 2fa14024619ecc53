"""Marks one notebook: each question in its own process, with a sentence about the result."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import cotlearn
from cotlearn.homework import isolation, submissions
from cotlearn.homework.assignments import Question, find
from cotlearn.homework.isolation import Job, Limits
from cotlearn.homework.registry import Verdict, printable
from cotlearn.homework.submissions import Submission


@dataclass(frozen=True)
class Mark:
    """The result for one answer.

    Attributes:
        question: name of the question.
        verdict: verdict of the self-check: "correct", "not yet" or "not attempted yet".
        sentence: explanation of the verdict.
        points: points earned in the hidden tests.
        out_of: largest possible number of points.
        hints: hints of the hidden tests that failed.
        sure: False if the process was killed from outside, so that another try may find more.
    """

    question: str
    verdict: str
    sentence: str
    points: float
    out_of: float
    hints: list[str] = field(default_factory=list)
    sure: bool = True

    @property
    def correct(self) -> bool:
        """Whether the self-check passes and no hidden test failed."""
        return self.verdict == Verdict.CORRECT and not self.hints


@dataclass(frozen=True)
class Marked:
    """The result for a notebook.

    Attributes:
        assignment: name such as "hw1"; "" if it is unknown.
        title: title of the assignment.
        marks: one mark per question.
        note: problem of the notebook as a whole; "" if there is none.
    """

    assignment: str = ""
    title: str = ""
    marks: list[Mark] = field(default_factory=list)
    note: str = ""

    @property
    def points(self) -> float:
        """The total of points earned."""
        return sum(mark.points for mark in self.marks)

    @property
    def out_of(self) -> float:
        """The largest possible total of points."""
        return sum(mark.out_of for mark in self.marks)


def mark(
    path: Path,
    *,
    hidden: bool = False,
    masters: Path | None = None,
    limits: Limits | None = None,
    alone: bool = True,
    each: Callable[[Mark], None] | None = None,
) -> Marked:
    """Marks a notebook.

    Args:
        path: The learner's notebook; it is read, not changed.
        hidden: Whether to run the hidden tests, which give points.
        masters: The folder of the master notebooks; the course's if None.
        limits: The limits on each question; the default ones if None.
        alone: Whether nothing else is marked at the same time. If so, an answer that is killed from
            outside is tried once more.
        each: Called with each mark as soon as it is known.

    Raises:
        Disturbed: An answer was killed from outside and `alone` is False.
        ValueError: The file is not a notebook, or it belongs to no assignment.
    """
    submission = submissions.read(path)
    if submission.assignment is None:
        why = "no cell calls check(...), and its name says nothing like hw1; take a fresh copy"
        raise ValueError(f"{path.name} belongs to no assignment: {why}")
    assignment = find(submission.assignment, masters)
    marks = []
    for question in assignment.questions:
        asked = question if hidden else replace(question, tests=())
        marks.append(_mark(submission, asked, assignment.setup, limits or Limits(), alone=alone))
        if each is not None:
            each(marks[-1])
    return Marked(assignment.name, assignment.title, marks, _note(submission))


def _mark(
    submission: Submission, question: Question, setup: str, limits: Limits, *, alone: bool
) -> Mark:
    """Marks an answer with the cells it needs; if that fails, with all cells above its check."""
    out_of = sum(test.points for test in question.tests)
    names = submissions.names_in(question.answer)
    found = {name: submission.defining(name) for name in sorted(names)}
    own = max((cell.number for cell in found.values() if cell is not None), default=0)
    missing = [name for name, cell in found.items() if cell is None]
    if missing:
        sentence = printable(_missing(submission, question, missing[0]))
        mark = Mark(question.name, Verdict.NOT_YET, sentence, 0, out_of)
    else:
        mark = _tried(Job(question, setup, submission.needed(names), own), limits, alone=alone)
    if mark.correct or mark.verdict == Verdict.NOT_ATTEMPTED:
        return mark
    cells = submission.until(question.name, names)
    whole = _tried(Job(question, setup, cells, own, as_notebook=True), limits, alone=alone)
    return max(mark, whole, key=lambda item: (item.points, item.correct))  # the first of equals


def _tried(job: Job, limits: Limits, *, alone: bool) -> Mark:
    """Runs a job, and repeats it once if it is disturbed and nothing else runs."""
    question = job.question
    sure = True
    try:
        findings, problem = isolation.run(job, limits)
    except isolation.Disturbed:
        if not alone:
            raise
        try:
            findings, problem = isolation.run(job, limits)
        except isolation.Disturbed as reason:
            findings, problem, sure = [], str(reason), False
    verdict, sentence = findings[0] if findings else (str(Verdict.NOT_YET), problem or "")
    complaints = findings[1:]
    tried = zip(question.tests, complaints, strict=False)  # fewer if the process ended early
    points = sum(test.points for test, complaint in tried if not complaint)
    if problem is not None and len(complaints) < len(question.tests):
        complaints.append(problem)
    hints = [printable(hint) for hint in dict.fromkeys(filter(None, complaints))]
    out_of = sum(test.points for test in question.tests)
    return Mark(question.name, verdict, printable(sentence), points, out_of, hints, sure)


def _missing(submission: Submission, question: Question, name: str) -> str:
    """A sentence that explains why the notebook has no answer of this name."""
    for cell in submission.cells:
        mentions = f"def {name}(" in cell.source or f"{name} =" in cell.source
        if cell.error and (cell.question == question.name or mentions):
            return f"cell {cell.number} is not Python that can be read: {cell.error}"
    for cell in submission.cells:
        if cell.question == question.name and cell.binds:
            words = f"the answer must be called {name}, and your cell defines"
            return f"{words} {' and '.join(sorted(cell.binds))}: give it its name back"
    words = f"there is no {name} in this notebook: its cell was deleted, emptied or renamed"
    return f"{words}; take it again from a fresh copy"


def _note(submission: Submission) -> str:
    """A note if the notebook was made with another minor version of cotlearn, else ""."""
    made, here = submission.version, cotlearn.__version__
    same = not made or made.split(".")[:2] == here.split(".")[:2]
    return "" if same else f"made with cotlearn {printable(made, 40)}, marked with {here}"
