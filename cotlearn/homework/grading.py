"""Grades a folder of notebooks: several at a time, resumable, with feedback for each student.

The result for each notebook is written immediately to its own file and reused when the same
notebook is graded with the same tests. So a run can be killed at any time and repeated.
"""

import contextlib
import csv
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import cotlearn
from cotlearn.files import write_text
from cotlearn.homework import assignments
from cotlearn.homework.isolation import Limits
from cotlearn.homework.marking import Mark, Marked, mark


@dataclass(frozen=True)
class Row:
    """One notebook of the folder.

    Attributes:
        file: relative to the folder.
        marked: what was found.
        kept: whether it was known from an earlier run.
    """

    file: str
    marked: Marked
    kept: bool = False


def grade(
    folder: Path,
    out: Path,
    *,
    masters: Path | None = None,
    workers: int | None = None,
    limits: Limits,
    each: Callable[[Row, int, int], None] | None = None,
) -> list[Row]:
    """Grades all notebooks in a folder and its subfolders.

    Args:
        folder: With the notebooks; they are read, not changed.
        out: The table to write, as CSV with a row for each notebook. Feedback goes to a folder of
            the same name without ".csv", one text for each notebook.
        masters: The folder of the master notebooks; those of the course if None.
        workers: Notebooks at a time; as many as there are cores if None.
        limits: On each question.
        each: Called as (row, notebooks done, notebooks in all).

    Returns:
        The rows, in the order of the files' names.

    Raises:
        ValueError: There is no such folder, or no notebook in it, or `out` is a folder.
        KeyboardInterrupt: Ctrl-C; what is done is kept.
    """
    if not folder.is_dir():
        raise ValueError(f"folder must be a folder of notebooks, got {folder}")
    if out.is_dir() or not out.suffix:
        raise ValueError(f"out must be a file such as grades.csv, got {out}")
    feedback = out.with_suffix("")
    paths = [
        path
        for path in sorted(folder.rglob("*.ipynb"))
        if ".ipynb_checkpoints" not in path.parts and not path.is_relative_to(feedback)
    ]
    if not paths:
        raise ValueError(f"there is no notebook (*.ipynb) in {folder}")
    tests = (hashlib.sha256(path.read_bytes()).hexdigest() for path in assignments.masters(masters))
    salt = json.dumps([cotlearn.__version__, *map(float, astuple(limits)), *tests])

    def one(path: Path) -> Row:
        file = path.relative_to(folder)
        stored = feedback / file.with_name(f"{file.name}.json")
        marked, kept = _marked(path, stored, salt, masters, limits)
        text = feedback_text(file.name, marked)
        write_text(stored.with_name(f"{file.stem}.md"), text)
        return Row(file.as_posix(), marked, kept)

    rows: list[Row] = []
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        try:
            for future in as_completed([pool.submit(one, path) for path in paths]):
                rows.append(future.result())
                if each is not None:
                    each(rows[-1], len(rows), len(paths))
        except BaseException:  # Ctrl-C too: those that run are finished, and no others begin
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    rows.sort(key=lambda row: row.file)
    write_text(out, table(rows), encoding="utf-8-sig")  # so that Excel reads the accents
    return rows


def _marked(
    path: Path, stored: Path, salt: str, masters: Path | None, limits: Limits
) -> tuple[Marked, bool]:
    """What was found about a notebook, and whether it was known from an earlier run."""
    try:
        key = hashlib.sha256(salt.encode() + path.read_bytes()).hexdigest()
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # missing or torn
            record = json.loads(stored.read_text(encoding="utf-8"))
            if record["key"] == key:
                known = record["marked"]
                return Marked(**{**known, "marks": [Mark(**item) for item in known["marks"]]}), True
        marked = mark(path, hidden=True, masters=masters, limits=limits)
    except ValueError as error:
        marked = Marked(note=str(error))
    except Exception as error:  # not the student's: said, and tried again the next time
        return Marked(note=f"{type(error).__name__}: {error}"), False
    write_text(stored, json.dumps({"key": key, "marked": asdict(marked)}, indent=1) + "\n")
    return marked, False


def table(rows: Iterable[Row]) -> str:
    """Returns a CSV table: file, assignment, points, what could be earned, note, each question."""
    rows = list(rows)
    asked = dict.fromkeys(item.question for row in rows for item in row.marked.marks)
    questions = sorted(asked, key=lambda name: name.split(".")[0])  # keeps an assignment's order
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(["file", "assignment", "points", "out_of", "percent", "note", *questions])
    for row in rows:
        marked = row.marked
        earned = {item.question: f"{item.points:g}" for item in marked.marks}
        out_of = f"{marked.out_of:g}" if marked.marks else ""
        percent = f"{100 * marked.points / marked.out_of:.0f}" if marked.out_of else ""
        found = [_plain(row.file), marked.assignment, f"{marked.points:g}", out_of, percent]
        each = (earned.get(name, "") for name in questions)
        writer.writerow([*found, _plain(marked.note), *each])
    return text.getvalue()


def _plain(text: str) -> str:
    """Keeps a spreadsheet from taking a student's text for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t")) else text


def feedback_text(file: str, marked: Marked) -> str:
    """Returns what a student gets to read, as Markdown."""
    if not marked.marks:
        return f"# {file}\n\nThis could not be graded: {marked.note}.\n"
    lines = [f"# {marked.title}", "", f"{file}: {marked.points:g} of {marked.out_of:g} points", ""]
    if marked.note:
        lines += [f"Note: {marked.note}.", ""]
    for item in marked.marks:
        lines += [f"## {item.question}: {item.points:g} of {item.out_of:g}", "", *_words(item), ""]
    return "\n".join(lines)


def _words(item: Mark) -> list[str]:
    if item.correct:
        return ["✓ correct"]
    if item.verdict == "not attempted yet":
        return ["not attempted"]
    first = f"✗ {item.sentence}"
    if item.verdict == "correct":
        first = "✓ the self-check passes, and a hidden test does not:"
    return [first, *(f"- {hint}" for hint in item.hints if hint != item.sentence)]
