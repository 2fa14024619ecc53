"""Grades a folder of notebooks, several at a time, with feedback for each student; resumable.

The result for each notebook is written to its own file at once, and reused if the same notebook is
graded with the same tests. So a run can be killed at any time and repeated.
"""

import contextlib
import csv
import hashlib
import hmac
import io
import json
import os
import secrets
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, astuple, dataclass
from pathlib import Path

import cotlearn
from cotlearn.files import atomic_path, write_text
from cotlearn.homework import assignments, isolation, submissions
from cotlearn.homework.isolation import Limits
from cotlearn.homework.marking import Mark, Marked, mark
from cotlearn.homework.registry import printable
from cotlearn.validation import check_output


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
    each: Callable[[Row, int, int], None] | None = None,
) -> list[Row]:
    """Grades all notebooks in a folder and its subfolders; every file gets a row.

    Args:
        folder: The folder of the notebooks; they are read, not changed.
        out: The table to write, a CSV file with one row per file. Feedback goes to a folder of the
            same name without ".csv", one text per file.
        masters: The folder of the master notebooks; the course's if None.
        workers: Number of notebooks graded in parallel; the number of cores if None.
        limits: The limits on each question.
        each: Called after each file as each(row, files done, files in total).

    Returns:
        The rows, sorted by file name.

    Raises:
        ValueError: The folder is missing or holds no notebook, `out` cannot be written, or there
            are no masters with hidden tests.
        KeyboardInterrupt: Ctrl-C was pressed; finished results are kept.
    """
    if not folder.is_dir():
        raise ValueError(f"folder must be a folder of notebooks, got {folder}")
    if out.is_dir() or not out.suffix:
        raise ValueError(f"out must be a file such as grades.csv, got {out}")
    feedback = out.with_suffix("")
    check_output(feedback / "text", "out")
    files = _handed_in(folder, {out.absolute(), feedback.absolute()})
    if not files:
        raise ValueError(f"there is no notebook (*.ipynb) in {folder}")
    tests = (hashlib.sha256(path.read_bytes()).hexdigest() for path in _masters(masters))
    salt = json.dumps([cotlearn.__version__, *map(float, astuple(limits)), *tests])
    known = _Known(feedback / ".known", salt)
    texts = _texts([file.relative_to(folder) for file in files])

    def one(path: Path, *, alone: bool = False) -> Row:
        file = path.relative_to(folder)
        marked, kept = _marked(path, file, known, masters, limits, alone=alone)
        name = printable(file.as_posix())
        write_text(feedback / texts[file], feedback_text(printable(file.name), marked))
        return Row(name, marked, kept)

    rows: list[Row] = []

    def add(row: Row) -> None:
        rows.append(row)
        if each is not None:
            each(row, len(rows), len(files))

    isolation.start_server()
    disturbed: list[Path] = []
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        futures = {pool.submit(one, path): path for path in files}
        try:
            for future in as_completed(futures):
                if isinstance(future.exception(), isolation.Disturbed):
                    disturbed.append(futures[future])
                else:
                    add(future.result())
        except BaseException:  # Ctrl-C too: no others begin, and those that run end
            isolation.stopping.set()
            pool.shutdown(cancel_futures=True)
            isolation.stopping.clear()
            raise
    for path in disturbed:
        add(one(path, alone=True))
    rows.sort(key=lambda row: row.file)
    write_text(out, table(rows), encoding="utf-8-sig")  # so that Excel reads the accents
    return rows


def _masters(folder: Path | None) -> list[Path]:
    """Returns the masters; raises ValueError if there are none or they have no hidden tests."""
    paths = assignments.masters(folder)
    if not paths:
        raise ValueError(f"there is no master notebook (hw1.ipynb, ...) in {folder}")
    for path in paths:
        asked = assignments.read(path, path.stem).questions
        if not any(question.tests for question in asked):
            raise ValueError(f"{path} has no hidden tests: masters must be a folder of masters")
    return paths


def _handed_in(folder: Path, own: set[Path]) -> list[Path]:
    """All files in a folder and its subfolders, except hidden files and this program's own.

    Folders that have the name of a notebook or cannot be opened are included.
    """
    found: set[Path] = set()
    walk = os.walk(folder, onerror=lambda error: found.add(Path(error.filename)))
    for name, folders, files in walk:
        place = Path(name)
        kept = {item for item in folders if not item.startswith((".", "__MACOSX"))}
        folders[:] = [item for item in kept if (place / item).absolute() not in own]
        strange = (item for item in folders if item.lower().endswith(".ipynb"))
        links = (item for item in folders if (place / item).is_symlink())
        seen = (item for item in files if not item.startswith("."))
        found.update(place / item for item in (*strange, *links, *seen))
    return sorted(path for path in found if path.absolute() not in own)


def _texts(files: list[Path]) -> dict[Path, Path]:
    """The path of each file's feedback: the file's own name with .md, if that name is usable."""
    texts: dict[Path, Path] = {}
    folders = {parent for file in files for parent in file.parents}
    for file in files:
        stem = file.stem if file.suffix == ".ipynb" else file.name
        text = file.with_name(f"{stem}.md")
        usable = len(os.fsencode(text.name)) < 200 and printable(str(text), 1000) == str(text)
        if text in folders or not usable or text in texts.values():
            digest = hashlib.sha256(os.fsencode(file)).hexdigest()[:16]
            text = Path(f"{printable(stem, 40)}.{digest}.md")
        texts[file] = text
    return texts


class _Known:
    """Results of earlier runs, signed so that an answer cannot forge them.

    The key is the environment variable `COTLEARN_GRADING_KEY`, which answers do not receive;
    without it, a file in the home folder, which malicious code can find.

    Args:
        folder: The folder with one file per notebook.
        salt: Everything but the notebook that the results depend on.
    """

    def __init__(self, folder: Path, salt: str) -> None:
        self.folder, self.salt = folder, salt
        secret = os.environ.get("COTLEARN_GRADING_KEY")
        file = Path.home() / ".cotlearn" / "grading.key"
        if secret is None and not file.is_file():
            with atomic_path(file) as temporary:
                temporary.touch(mode=0o600)
                temporary.chmod(0o600)
                temporary.write_text(secrets.token_hex(32), encoding="ascii")
        self._key = (secret or file.read_text(encoding="ascii")).encode()

    def read(self, file: Path, content: bytes) -> Marked | None:
        """Returns the stored result for a notebook with this content, or None."""
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):  # missing or torn
            record = json.loads(self._path(file).read_text(encoding="utf-8"))
            signature = self._sign(file, content, record["marked"])
            if hmac.compare_digest(record["signature"], signature):
                known = record["marked"]
                return Marked(**{**known, "marks": [Mark(**item) for item in known["marks"]]})
        return None

    def write(self, file: Path, content: bytes, marked: Marked) -> None:
        """Stores a result."""
        found = asdict(marked)
        record = {"signature": self._sign(file, content, found), "marked": found}
        write_text(self._path(file), json.dumps(record, indent=1) + "\n")

    def _path(self, file: Path) -> Path:
        return self.folder / f"{hashlib.sha256(os.fsencode(file)).hexdigest()[:32]}.json"

    def _sign(self, file: Path, content: bytes, found: object) -> str:
        digest = hashlib.sha256(content).hexdigest()
        text = json.dumps([self.salt, os.fsencode(file).hex(), digest, found], sort_keys=True)
        return hmac.new(self._key, text.encode(), "sha256").hexdigest()


def _marked(
    path: Path, file: Path, known: _Known, masters: Path | None, limits: Limits, *, alone: bool
) -> tuple[Marked, bool]:
    """Returns the result for a file, and whether it comes from an earlier run."""
    try:
        submissions.examine(path)
        content = path.read_bytes()
        if (found := known.read(file, content)) is not None:
            return found, True
        marked = mark(path, hidden=True, masters=masters, limits=limits, alone=alone)
    except isolation.Disturbed:
        raise
    except Exception as error:
        kind = "" if isinstance(error, ValueError | OSError) else f"{type(error).__name__}: "
        return Marked(note=printable(f"{kind}{error}")), False
    if all(item.sure for item in marked.marks):
        known.write(file, content, marked)
    return marked, False


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
        percent = f"{100 * marked.points / marked.out_of:.0f}" if marked.out_of else ""
        found = [_plain(row.file), marked.assignment, f"{marked.points:g}", out_of, percent]
        each = (earned.get(name, "") for name in questions)
        writer.writerow([*found, _plain(marked.note), *each])
    return text.getvalue()


def _plain(text: str) -> str:
    """Escapes a student's text that a spreadsheet would take for a formula."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t")) else text


def feedback_text(file: str, marked: Marked) -> str:
    """Returns the feedback for a student, as Markdown."""
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
