"""Marks one notebook: its cells and its answers run in a fresh kernel.

First run the cells that import or answer, which takes seconds. Whatever is not right then is tried
again with all cells, in order, as a person would run them. A step that ends its kernel is left out
of the next one, so that it costs nothing else.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import cotlearn
from cotlearn.course import submissions
from cotlearn.course.assignments import Question, find
from cotlearn.course.checking import TOO_LONG, Verdict, printable
from cotlearn.course.kernel import Ended, Kernel, Limits, started
from cotlearn.course.submissions import Cell, Submission

KERNELS = 10  #: that a notebook may take
NOT_REACHED = "not reached"  #: how the sentence on an answer begins that no kernel came to
_IN_FILE = re.compile(r" \(\S+\.py, line (\d+)\)$")  #: the kernel's own name for a cell
_MISSING = re.compile(r"name '(\w+)' is not defined")

#: A cell, by its number, or a test, by its question and number; 0 is the self-check.
Step = int | tuple[str, int]
Result = TypeVar("Result")


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
    """

    question: str
    verdict: str
    sentence: str
    points: float = 0.0
    out_of: float = 0.0
    hints: list[str] = field(default_factory=list)

    @property
    def correct(self) -> bool:
        """Whether the self-check passes and no hidden test failed."""
        return self.verdict == Verdict.CORRECT and not self.hints

    @property
    def settled(self) -> bool:
        """Whether no other try can find more."""
        return self.correct or self.verdict == Verdict.NOT_ATTEMPTED


@dataclass(frozen=True)
class Marked:
    """The result for a notebook.

    Attributes:
        assignment: name such as "hw1"; "" if it is unknown.
        title: title of the assignment.
        marks: one mark per question.
        note: what concerns the whole notebook, such as a cell that was left out; else "".
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
    path: Path, *, hidden: bool = False, masters: Path | None = None, limits: Limits | None = None
) -> Marked:
    """Marks a notebook.

    Args:
        path: The learner's notebook; it is read, not changed.
        hidden: Whether to run the hidden tests, which give points.
        masters: The folder of the master notebooks; the course's if None.
        limits: On each cell and test; the default ones if None.

    Raises:
        ValueError: The file is not a notebook, or it belongs to no assignment.
        RuntimeError: No kernel could be started.
    """
    submission = submissions.read(path)
    assignment = find(submission.assignment, masters)
    questions = assignment.questions
    if not hidden:
        questions = tuple(replace(question, tests=()) for question in questions)
    marking = _Marking(submission, questions)
    marks = marking.run(limits or Limits())
    notes = [*_other_version(submission), *marking.notes()]
    return Marked(assignment.name, assignment.title, marks, "; ".join(notes))


def _other_version(submission: Submission) -> Iterator[str]:
    made, here = submission.version, cotlearn.__version__
    if made and made.split(".")[:2] != here.split(".")[:2]:
        yield f"made with cotlearn {printable(made, 40)}, marked with {here}"


class _Marking:
    """The marks of a notebook so far, and the steps that the next kernel leaves out."""

    def __init__(self, submission: Submission, questions: Sequence[Question]) -> None:
        self.submission, self.questions = submission, questions
        self.marks: dict[str, Mark] = {}
        self.step: Step = 0  # the last that was taken
        self.left_out: dict[Step, str] = {}  # what they did
        self.skipped: set[Step] = set()  # those of them that were due again
        self.errors: dict[int, str] = {}  # of cells

    def run(self, limits: Limits) -> list[Mark]:
        """Takes kernels until no further one can change a mark."""
        whole = self.submission.cells
        cells = [cell for cell in whole if cell.plain]
        for _ in range(KERNELS):
            ended, self.step = False, 0
            try:
                with started(limits, self.questions[0].name) as kernel:
                    self._go_through(cells, kernel)
            except Ended as end:
                ended = True
                self.left_out[self.step] = str(end)
                self._leave_out_calls(str(end))
            if not self._open() or (cells == whole and not ended):
                break
            cells = whole
        return [self.marks.get(asked.name) or _lost(asked) for asked in self.questions]

    def notes(self) -> Iterator[str]:
        """Says of each cell that was left out, or that failed and is missed, what it did."""
        for cell in self.submission.cells:
            if cell.number in self.skipped:
                did = self.left_out[cell.number].partition(";")[0].removesuffix(" and was stopped")
                yield f"cell {cell.number} {did} and was left out"
            elif names := self._missed(cell):
                lost = ", ".join(names)
                yield f"cell {cell.number} {self.errors[cell.number]} (missing later: {lost})"

    def _missed(self, cell: Cell) -> list[str]:
        """The names in a cell that failed which an answer did not find."""
        error = self.errors.get(cell.number)
        if error is None:
            return []
        said = [text for mark in self.marks.values() for text in (mark.sentence, *mark.hints)]
        missing = dict.fromkeys(name for text in said for name in _MISSING.findall(text))
        own = _MISSING.findall(error)  # the cell itself did not find them
        in_it = set(re.findall(r"\w+", cell.source)).difference(own)
        return [name for name in missing if name in in_it]

    def _leave_out_calls(self, why: str) -> None:
        """An answer that never ended is not called again: each of its calls would take as long."""
        if TOO_LONG not in why or isinstance(self.step, int):
            return
        [asked] = [asked for asked in self.questions if asked.name == self.step[0]]
        for cell in self.submission.cells:
            if f"{asked.answer}(" in cell.source and not any(map(cell.defines, self.questions)):
                self.left_out.setdefault(cell.number, f"calls {asked.answer}, which {why}")

    def _open(self) -> list[Question]:
        """The questions of which another try may find more."""
        settled = {name for name, mark in self.marks.items() if mark.settled}
        return [asked for asked in self.questions if asked.name not in settled]

    def _go_through(self, cells: list[Cell], kernel: Kernel) -> None:
        """Runs cells, and judges each open answer after the last one that checks or defines it."""
        after: dict[int, list[Question]] = {}
        for asked in self._open():
            last = max((cell.number for cell in cells if cell.is_of(asked)), default=0)
            after.setdefault(last, []).append(asked)
        for cell in cells:
            if cell.number <= max(after, default=0):
                self._run(cell, kernel)
            for asked in after.get(cell.number, []):
                self._judge(asked, kernel)
        for asked in after.get(0, []):
            self._judge(asked, kernel)

    def _run(self, cell: Cell, kernel: Kernel) -> None:
        self.errors.pop(cell.number, None)  # of an earlier kernel
        for output in self._take(cell.number, kernel.run, cell.source) or []:
            if output["output_type"] == "error":
                words = _IN_FILE.sub(r" in its line \1", " ".join(output["evalue"].split()))
                self.errors[cell.number] = printable(f"raised {output['ename']}: {words}")

    def _judge(self, asked: Question, kernel: Kernel) -> None:
        """Adds the mark of an answer, unless an earlier one is better."""
        found = self._take((asked.name, 0), kernel.check, asked.name, asked.answer)
        verdict, sentence = found or (None, f"your answer {self.left_out.get((asked.name, 0))}")
        sentence = sentence or self._why_missing(asked)
        hints = []
        for number, test in enumerate(asked.tests, start=1):
            if verdict in (None, Verdict.NOT_ATTEMPTED):
                break
            step = asked.name, number
            hint = self._take(step, kernel.test, test.source, test.hint)
            hints.append(f"your answer {self.left_out[step]}" if hint is None else hint)
        passed = (test.points for test, hint in zip(asked.tests, hints, strict=False) if not hint)
        failed = list(dict.fromkeys(filter(None, hints)))
        mark = Mark(
            asked.name,
            verdict or Verdict.NOT_YET,
            printable(sentence),
            sum(passed),
            asked.points,
            failed,
        )
        before = self.marks.get(asked.name, mark)
        self.marks[asked.name] = max(mark, before, key=lambda one: (one.points, one.correct))

    def _take(self, step: Step, work: Callable[..., Result], *given: str) -> Result | None:
        """Takes a step, or returns None if it is left out."""
        if step in self.left_out:
            self.skipped.add(step)
            return None
        self.step = step
        return work(*given)

    def _why_missing(self, asked: Question) -> str:
        for cell in self.submission.cells:
            error = self.left_out.get(cell.number) or self.errors.get(cell.number)
            if error and cell.defines(asked):
                return f"your cell (number {cell.number} of the notebook) {error}"
        words = f"there is no {asked.answer} in this notebook: its cell was deleted or renamed"
        return f"{words}; take it again from a fresh copy"


def _lost(asked: Question) -> Mark:
    words = f"{NOT_REACHED}: {KERNELS} times something else ended Python, or never ended"
    return Mark(asked.name, Verdict.NOT_YET, words, out_of=asked.points)
