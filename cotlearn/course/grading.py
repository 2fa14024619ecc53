"""Grades a folder of notebooks, with a table and a page for each student; resumable.

The result for each notebook is kept at once, under a name made of the notebook and the tests. So a
run can be stopped at any time and repeated: only what is new or changed is graded.
"""

import csv
import hashlib
import io
import json
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import cotlearn
from cotlearn.course import assignments, checks, submissions
from cotlearn.course.checking import TOO_LONG, printable
from cotlearn.course.kernel import Limits, in_parallel
from cotlearn.course.marking import NOT_REACHED, Mark, Marked, mark
from cotlearn.course.submissions import MOST_BYTES
from cotlearn.files import write_text

LESSON = "a lesson, not homework: its exercises have no points"  #: a note


@dataclass(frozen=True)
class Row:
    """The result for one file in the folder.

    Attributes:
        file: path relative to the folder, as printable text.
        marked: the result.
        kept: whether the result comes from an earlier run.
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
    begin: Callable[[str], None] | None = None,
    each: Callable[[Row, int, int], None] | None = None,
    meanwhile: Callable[[list[str], int, int], None] | None = None,
) -> list[Row]:
    """Grades all notebooks in a folder and its subfolders; every file gets a row.

    Args:
        folder: The folder of the notebooks; they are read, not changed.
        out: The table to write, a CSV file with one row per file. The pages go to a folder of the
            same name without ".csv", one per file.
        masters: The folder of the master notebooks; the course's if None.
        workers: Number of notebooks graded in parallel; the number of cores if None.
        limits: The limits on each notebook.
        begin: Called with the name of each file that takes a kernel, from several threads.
        each: Called after each file as each(row, files done, files in total).
        meanwhile: Called after each minute in which no file was done, as meanwhile(names of the
            files that are being marked, files done, files in total).

    Returns:
        The rows, sorted by file name.

    Raises:
        ValueError: The folder is missing or holds no file, `out` does not end in ".csv" or cannot
            be written, its pages would lie among the hand-ins, or there are no masters with hidden
            tests.
        KeyboardInterrupt: Ctrl-C was pressed; finished results are kept.
    """
    if not folder.is_dir():
        raise ValueError(f"folder must be a folder of notebooks, got {folder}")
    pages = submissions.pages_of(folder, out)
    files = _handed_in(folder, without={out.absolute(), pages.absolute()})
    if not files:
        raise ValueError(f"there is no notebook (*.ipynb) in {folder}")
    tests = _about(_masters(masters), limits)
    rows: list[Row] = []
    begun: list[str] = []

    def name(path: Path) -> str:
        return printable(path.relative_to(folder).as_posix(), 1000)

    def known(path: Path) -> Path:
        return pages / ".known" / f"{_digest(path, tests)}.json"

    def at_once(path: Path) -> Row | None:
        if (marked := _read(known(path))) is not None:
            return Row(name(path), marked, kept=True)
        try:
            assignments.find(submissions.read(path).assignment, masters)
        except Exception as error:  # whatever it is, it costs this row only
            return Row(name(path), _ungraded(path, error))
        return None

    def one(path: Path) -> Row:
        begun.append(name(path))
        if begin is not None:
            begin(name(path))
        try:
            marked = mark(path, hidden=True, masters=masters, limits=limits)
        except Exception as error:
            return Row(name(path), _ungraded(path, error))
        write_text(known(path), json.dumps(asdict(marked), indent=1) + "\n")
        return Row(name(path), marked)

    def then(row: Row) -> None:
        rows.append(row)
        _write_page(row, pages)
        if each is not None:
            each(row, len(rows), len(files))

    def a_minute_later() -> None:
        done = {row.file for row in rows}
        if meanwhile is not None:
            meanwhile([file for file in begun if file not in done], len(rows), len(files))

    waiting = []
    for path in files:  # those that need no kernel wait for no other
        if (row := at_once(path)) is not None:
            then(row)
        else:
            waiting.append(path)
    at_most = workers or os.cpu_count() or 1
    in_parallel(one, waiting, workers=at_most, then=then, meanwhile=a_minute_later)
    rows.sort(key=lambda row: row.file)
    write_text(out, table(rows), encoding="utf-8-sig")  # so that Excel reads the accents
    return rows


def _ungraded(path: Path, error: Exception) -> Marked:
    """The result for a file that cannot be marked; its name stands beside it."""
    kind = "" if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: "
    words = str(error)
    if words.startswith(f"{path.name} "):
        words = f"it{words.removeprefix(path.name)}"
    return Marked(note=printable(f"{kind}{words}"))


def _handed_in(folder: Path, *, without: set[Path]) -> list[Path]:
    """All files but hidden ones and this program's own; a folder called *.ipynb counts, too."""
    found = []
    for path in sorted(folder.rglob("*")):
        hidden = any(part.startswith((".", "__MACOSX")) for part in path.relative_to(folder).parts)
        own = without & {path.absolute(), *path.absolute().parents}
        a_file = not path.is_dir() or path.suffix == ".ipynb"
        if a_file and not hidden and not own:
            found.append(path)
    return found


def _masters(folder: Path | None) -> list[Path]:
    """Returns the masters; raises ValueError if there are none or they have no hidden tests."""
    paths = assignments.masters(folder)
    if not paths:
        raise ValueError(f"there is no master notebook (hw1.ipynb, ...) in {folder}")
    for path in paths:
        if not any(asked.tests for asked in assignments.read(path, path.stem).questions):
            raise ValueError(f"{path} has no hidden tests: masters must be a folder of masters")
    return paths


def _about(masters: Iterable[Path], limits: Limits) -> str:
    """What a result depends on, but for the notebook."""
    folders = checks.folder(), Path(__file__).parent
    code = [file for folder in folders for file in sorted(folder.glob("*.py"))]
    files = [*masters, *code]
    sums = [hashlib.sha256(path.read_bytes()).hexdigest() for path in files]
    return json.dumps([cotlearn.__version__, asdict(limits), sums])


def _digest(path: Path, tests: str) -> str:
    """The name under which the result of a notebook is kept."""
    regular = path.is_file() and not path.is_symlink() and path.stat().st_size <= MOST_BYTES
    content = path.read_bytes() if regular else b""  # of which `mark` says what it is
    about = f"{tests}\0{path.name}\0".encode(errors="surrogateescape")
    return hashlib.sha256(about + content).hexdigest()[:32]


def _read(known: Path) -> Marked | None:
    """Returns a result of an earlier run; None if it is missing or torn."""
    try:
        stored = json.loads(known.read_text(encoding="utf-8"))
        return Marked(**{**stored, "marks": [Mark(**item) for item in stored["marks"]]})
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _write_page(row: Row, pages: Path) -> None:
    """Writes the page of a row, in the folder and under the name of its file."""
    file = Path(row.file)
    name = file.name
    if len(name.encode()) > 200:  # with its new ending it may be too long
        name = hashlib.sha256(name.encode()).hexdigest()[:16]
    write_text(pages / file.parent / f"{name}.md", page(file.name, row.marked))


def table(rows: Iterable[Row]) -> str:
    """Returns a CSV table: file, assignment, points, possible points, note, each question."""
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
        percent = f"{100 * marked.points / marked.out_of:.0f}" if marked.out_of else "0"
        found = [_plain(row.file), marked.assignment, f"{marked.points:g}", out_of, percent]
        each = (earned.get(name, "") for name in questions)
        writer.writerow([*found, _plain(_remarks(marked)), *each])
    return text.getvalue()


def _remarks(marked: Marked) -> str:
    """The note on a notebook, and which answers were stopped or not reached."""
    said = [(item.question, text) for item in marked.marks for text in (item.sentence, *item.hints)]
    said = [(name, text) for name, text in said if TOO_LONG in text or NOT_REACHED in text]
    stopped = [f"{name}: {text.partition(';')[0]}" for name, text in said]
    return "; ".join(dict.fromkeys(filter(None, [marked.note, _without_points(marked), *stopped])))


def _without_points(marked: Marked) -> str:
    """What a teacher is told of a lesson among the homework."""
    return LESSON if marked.marks and not marked.out_of else ""


def _plain(text: str) -> str:
    """Escapes a student's text that a spreadsheet would take for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t")) else text


def page(file: str, marked: Marked) -> str:
    """Returns the page of a student, as Markdown."""
    file, note = _plain_markdown(file), _plain_markdown(marked.note)
    if not marked.marks:
        return f"# {file}\n\nThis could not be graded: {note}.\n"
    lines = [f"# {marked.title}", "", f"{file}: {marked.points:g} of {marked.out_of:g} points", ""]
    lines += [f"Note: {text}.\n" for text in (note, _without_points(marked)) if text]
    for item in marked.marks:
        lines += [f"## {item.question}: {item.points:g} of {item.out_of:g}", "", *_words(item), ""]
    return "\n".join(lines)


def _words(item: Mark) -> list[str]:
    if item.correct:
        return ["✓ correct"]
    if item.verdict == "not attempted yet":
        return ["not attempted"]
    first = f"✗ {_plain_markdown(item.sentence)}"
    if item.verdict == "correct":
        first = "✓ the self-check passes, and a hidden test does not:"
    hints = (hint for hint in item.hints if hint != item.sentence)
    return [first, *(f"- {_plain_markdown(hint)}" for hint in hints)]


def _plain_markdown(text: str) -> str:
    """Escapes a text in which a student's words may be, so that it is shown as it is.

    No tag, link, image, code or emphasis comes of it. An underscore inside a word is none, and "<="
    stays as it is, for those who read the page as text.
    """
    marks = r"\\(?=[^\w\s])|[`*\[]|(?<![^\W_])_|_(?![^\W_])"
    text = re.sub(r"&(?=#?\w+;)", "&amp;", re.sub(marks, r"\\\g<0>", text))
    return re.sub(r"<(?=[^\s=\d])", "&lt;", text)
