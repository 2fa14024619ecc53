"""`cotlearn check`, `progress`, `grade` and `homework`: self-checks and grades."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape
from rich.table import Table

from cotlearn import assets
from cotlearn.cli.terminal import console, reported

if TYPE_CHECKING:
    from cotlearn.homework.grading import Row
    from cotlearn.homework.isolation import Limits
    from cotlearn.homework.marking import Mark

app = typer.Typer()

_Seconds = Annotated[float, typer.Option(min=1, help="Computing time per question, in s.")]
_Gigabytes = Annotated[float, typer.Option(min=0.1, help="GB per question (only on Linux).")]
_Masters = Annotated[Path | None, typer.Option(help="Folder of masters; default: the course's.")]
_SIGNS = {"correct": "[green]✓[/]", "not yet": "[red]✗[/]", "not attempted yet": "·"}


@app.command()
def check(
    notebook: Annotated[list[str], typer.Argument(help="Files, or numbers (01) in the course.")],
    seconds: _Seconds = 60,
    gigabytes: _Gigabytes = 4,
) -> None:
    """Checks the answers in notebooks, each in its own process.

    The notebooks are not changed. An endless loop, an exit or a flood of prints costs only its own
    question.
    """
    wrong = 0
    with reported(RuntimeError):
        from cotlearn.homework import progress
        from cotlearn.homework.marking import mark
        from cotlearn.homework.registry import printable

        limits = _limits(seconds, gigabytes)
        for name in notebook:
            path = Path(name) if Path(name).exists() else assets.find_notebook(name)
            console.print(f"[bold]{escape(printable(path.name))}[/]")
            marked = mark(path, limits=limits, each=_print)
            if marked.note:
                console.print(f"note: {escape(marked.note)}")
            done = sum(item.correct for item in marked.marks)
            console.print(f"{done} of {len(marked.marks)} correct")
            wrong += len(marked.marks) - done
            progress.remember({item.question: item.verdict for item in marked.marks})
    raise typer.Exit(1 if wrong else 0)


def _print(mark: Mark) -> None:
    text = "" if mark.verdict == "correct" else f": {mark.sentence}"
    console.print(f"{_SIGNS[mark.verdict]} {mark.question}{escape(text)}")


@app.command("progress")
def show_progress() -> None:
    """Shows which exercises are done and which is next, from one file on this machine."""
    with reported():
        from cotlearn.homework import progress
        from cotlearn.homework.assignments import find, masters

        names = [path.name[:2] for path in assets.notebooks()] + [path.stem for path in masters()]
        found = [find(name) for name in names]
        if not found:
            raise ValueError(f"no notebooks in {assets.course_folder()}; get the course again")
    known = {name: item["verdict"] for name, item in progress.read().items()}
    table, left = Table(box=None, show_header=False, pad_edge=False), []
    for assignment in found:
        verdicts = [known.get(item.name, "not attempted yet") for item in assignment.questions]
        done = f"{verdicts.count('correct')} of {len(verdicts)}"
        table.add_row(escape(assignment.title), done, " ".join(_SIGNS[v] for v in verdicts))
        for item, verdict in zip(assignment.questions, verdicts, strict=True):
            if verdict != "correct":
                left.append(f"{item.name} in {assignment.path.name}")
    console.print(table)
    console.print(f"next: {left[0]}" if left else "all exercises are done")
    console.print(f"kept in {escape(str(progress.file()))}, and sent nowhere")


@app.command()
def grade(
    folder: Annotated[Path, typer.Argument(help="The folder of the notebooks to grade.")],
    out: Annotated[Path, typer.Option(help="The table to write.")] = Path("grades.csv"),
    masters: _Masters = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Default: one per core.")] = None,
    seconds: _Seconds = 60,
    gigabytes: _Gigabytes = 4,
) -> None:
    """Grades a folder of notebooks with the hidden tests, and writes feedback for each student.

    Run it again after an interruption: finished results are kept. The limits guard against
    accidents and are not a security sandbox; docs/teaching/grading.md shows how to grade a class
    that you do not trust.
    """
    with reported():
        from cotlearn.homework import grading

        if out.with_suffix("").resolve() == folder.resolve():
            raise ValueError(f"out must have another name than the folder {folder}, got {out}")
        limits = _limits(seconds, gigabytes)
        rows = grading.grade(
            folder, out, masters=masters, workers=workers, limits=limits, each=_print_row
        )
    unread = [row for row in rows if not row.marked.marks]
    known = sum(row.kept for row in rows)
    console.print(f"{len(rows)} files: {known} known from before, {len(unread)} not gradable")
    console.print(f"table: {escape(str(out))}; feedback: {escape(str(out.with_suffix('')))}")


def _print_row(row: Row, done: int, total: int) -> None:
    marked = row.marked
    result = f"{marked.points:g} of {marked.out_of:g}" if marked.marks else marked.note
    console.print(f"{done}/{total} {escape(row.file)}: {escape(result)}")


@app.command()
def homework(
    out: Annotated[Path, typer.Option(help="The folder to write.")] = Path("build/homework"),
    secret_seed: Annotated[
        str | None,
        typer.Option(envvar="SECRET_SEED", help="Any text; gives you hidden tests of your own."),
    ] = None,
    requirements: Annotated[Path | None, typer.Option(help="Of otter's container.")] = None,
    masters: _Masters = None,
) -> None:
    """Makes student and autograder versions of the homework with otter-grader, and tests them."""
    with reported():
        from cotlearn.homework import release
        from cotlearn.validation import check_output

        check_output(out / "masters", "out")
        release.make(
            out,
            masters=masters,
            secret_seed=secret_seed,
            requirements=requirements,
            say=lambda text: console.print(escape(text)),
        )


def _limits(seconds: float, gigabytes: float) -> Limits:
    """Returns the limits; prints a note on systems without a memory limit."""
    from cotlearn.homework.isolation import Limits, has_memory_limit
    from cotlearn.validation import check_number

    check_number(seconds, "seconds", minimum=1)
    check_number(gigabytes, "gigabytes", minimum=0.1)
    if not has_memory_limit():
        console.print("note: this system cannot limit the memory that an answer takes")
    return Limits(seconds, gigabytes)
