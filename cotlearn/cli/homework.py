"""`cotlearn check`, `progress`, `grade` and `homework`: self-checks and grades."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import console, reported
from cotlearn.course import copies, record, submissions
from cotlearn.course.checking import printable
from cotlearn.course.overview import SIGNS
from cotlearn.files import check_output
from cotlearn.interrupt import loading

if TYPE_CHECKING:
    from cotlearn.course.grading import Row
    from cotlearn.course.kernel import Limits
    from cotlearn.course.marking import Marked

app = typer.Typer()

_Seconds = Annotated[float, typer.Option(min=1, help="Time for a cell or a test, in s.")]
_Gigabytes = Annotated[float, typer.Option(min=0.1, help="GB per notebook (only on Linux).")]
_Masters = Annotated[Path | None, typer.Option(help="Folder of masters; default: the course's.")]


@app.command()
def check(
    notebook: Annotated[list[str], typer.Argument(help="Files, or numbers (01) of your copies.")],
    seconds: _Seconds = 60,
    gigabytes: _Gigabytes = 4,
) -> None:
    """Checks the answers in notebooks, each in a fresh kernel.

    The notebooks are not changed. An endless loop or an exit costs only its own question.
    """
    wrong = 0
    with reported(RuntimeError):
        paths = [Path(name) if Path(name).exists() else copies.find(name) for name in notebook]
        for path in paths:
            near = path.resolve().is_relative_to(Path.cwd())  # which of two copies it is
            shown = os.path.relpath(path) if near else path.name
            console.print(f"[bold]{escape(printable(shown))}[/]: checking ...")
            from cotlearn.course.kernel import in_parallel  # takes seconds
            from cotlearn.course.marking import mark

            limits = _limits(seconds, gigabytes)
            found: list[Marked] = []
            in_parallel(partial(mark, limits=limits), [path], workers=1, then=found.append)
            _print(found[0])
            wrong += sum(not item.correct for item in found[0].marks)
            record.remember({item.question: item.verdict for item in found[0].marks})
    raise typer.Exit(1 if wrong else 0)


def _print(found: Marked) -> None:
    if found.note:
        console.print(f"note: {escape(found.note)}")
    for mark in found.marks:
        text = "" if mark.verdict == "correct" else f": {mark.sentence}"
        console.print(f"{SIGNS[mark.verdict]} {mark.question}{escape(text)}")
    done = sum(item.correct for item in found.marks)
    console.print(f"{done} of {len(found.marks)} correct")


@app.command("progress")
def show_progress() -> None:
    """Shows which exercises are done and which is next, from one file on this machine."""
    with reported():
        from cotlearn.course import progress

        progress()


@app.command()
def grade(
    folder: Annotated[Path, typer.Argument(help="The folder of the notebooks to grade.")],
    out: Annotated[Path, typer.Option(help="The table to write (.csv).")] = Path("grades.csv"),
    masters: _Masters = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Default: one per core.")] = None,
    seconds: _Seconds = 60,
    gigabytes: _Gigabytes = 4,
) -> None:
    """Grades a folder of notebooks with the hidden tests, and writes a page for each student.

    Run it again after an interruption: finished results are kept. The limits guard against
    accidents and are no sandbox; docs/teaching/grading.md shows how to grade a class that you do
    not trust.
    """
    with reported():
        if not folder.is_dir():
            raise ValueError(f"folder must be a folder of notebooks, got {folder}")
        pages = submissions.pages_of(folder, out)
        console.print("loading the tests ...")
        with loading():
            from cotlearn.course import grading

        console.print(f"reading the files in {escape(printable(str(folder)))} ...")
        limits = _limits(seconds, gigabytes)
        rows = grading.grade(
            folder,
            out,
            masters=masters,
            workers=workers,
            limits=limits,
            begin=lambda file: console.print(f"{escape(file)}: marking ..."),
            each=_print_row,
            meanwhile=_print_wait,
        )
    unread = [row for row in rows if not row.marked.marks]
    known = sum(row.kept for row in rows)
    console.print(f"{len(rows)} files: {known} known from before, {len(unread)} not gradable")
    console.print(f"table: {escape(str(out))}; pages: {escape(str(pages))}")


def _print_row(row: Row, done: int, total: int) -> None:
    marked = row.marked
    result = f"{marked.points:g} of {marked.out_of:g}" if marked.marks else marked.note
    console.print(f"{escape(row.file)}: {escape(result)} ({done} of {total})")


def _print_wait(files: list[str], done: int, total: int) -> None:
    console.print(f"still marking {escape(', '.join(files))} ({done} of {total} done)")


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
        from cotlearn.course import release

        check_output(out / "masters" / "hw1.ipynb", "out")
        release.make(
            out,
            masters=masters,
            secret_seed=secret_seed,
            requirements=requirements,
            say=lambda text: console.print(escape(text)),
        )


def _limits(seconds: float, gigabytes: float) -> Limits:
    """Returns the limits; prints a note on systems without a memory limit."""
    from cotlearn.course.kernel import Limits, has_memory_limit

    if not has_memory_limit():
        console.print("note: this system cannot limit the memory that an answer takes")
    return Limits(seconds, gigabytes)
