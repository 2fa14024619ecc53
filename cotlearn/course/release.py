"""Makes student and autograder versions of the homework with otter-grader, and tries them.

For instructors; otter-grader comes with the extra `instructor`.
"""

import hashlib
import importlib.util
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import nbformat

import cotlearn
from cotlearn.course import assets, assignments
from cotlearn.course.execution import METADATA, read
from cotlearn.course.marking import mark
from cotlearn.extras import how_to_install
from cotlearn.files import write_text

_SEED = re.compile(r"^(\s*)seed = \d+$", re.MULTILINE)


def make(
    out: Path,
    *,
    masters: Path | None = None,
    secret_seed: str | None = None,
    requirements: Path | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Makes all versions and checks that solutions pass and unchanged stubs fail.

    For each homework, `out` receives `student/hw1.ipynb` to hand out, `autograder/hw1/` with the
    solutions and otter's zip file, and `masters/hw1.ipynb` for `cotlearn grade --masters`. Without
    a secret seed, the student versions are also written to the course's own folder.

    Args:
        out: The destination folder; created if it does not exist.
        masters: The folder of the masters; the course's if None.
        secret_seed: Any text; gives the hidden tests random numbers that are in no public file.
            Answers can see them while they are graded. The student versions do not change.
        requirements: A requirements file for otter's container; it must include cotlearn.
        say: Called with each line of the report.

    Raises:
        ModuleNotFoundError: otter-grader is not installed.
        ValueError: Otter failed, a solution does not pass, or a stub does not fail.
    """
    if importlib.util.find_spec("otter") is None:
        raise ModuleNotFoundError(f"otter-grader is missing: {how_to_install('instructor')}")
    paths = assignments.masters(masters)
    if not paths:
        raise ValueError(f"there is no master notebook (hw1.ipynb, ...) in {masters}")
    out, home = out.resolve(), assets.course_folder() / "notebooks" / "homework"
    for path in paths:
        master = out / "masters" / path.name
        say(f"{path.stem}: otter makes its versions, and they are tried; about a minute ...")
        notebook = seeded(read(path), path.stem, secret_seed)
        if requirements is not None:
            notebook.cells[0].source += f"\nrequirements: {requirements.resolve()}"
        _write(master, notebook)
        student, solutions = _assign(master, out)
        student = stamped(student, path)
        _write(out / "student" / path.name, student)
        _try(path.stem, out, solutions, say)
        if secret_seed is None and path.parent == home:
            _write(home / "student" / path.name, student)
            say(f"{path.stem}: student version also in {home / 'student'}")
    if secret_seed is not None:
        say(f"grade with: cotlearn grade FOLDER --masters {out / 'masters'}")


def seeded(notebook: Any, name: str, secret: str | None) -> Any:
    """Replaces the seeds of a master's hidden tests by numbers derived from a secret, in place.

    Args:
        notebook: The master.
        name: The name of the homework.
        secret: Any text; None leaves the notebook unchanged.
    """
    if secret is None:
        return notebook
    for i, cell in enumerate(notebook.cells):
        if cell.cell_type == "code" and "# BEGIN TEST CONFIG" in cell.source:
            digest = hashlib.sha256(f"{secret}\0{name}\0{i}".encode()).digest()
            number = int.from_bytes(digest[:4], "big") >> 1
            cell.source, found = _SEED.subn(rf"\g<1>seed = {number}", cell.source)
            if not found:
                raise ValueError(f"a hidden test of {name} has no line 'seed = ...': cell {i}")
    return notebook


def stamped(notebook: Any, master: Path) -> Any:
    """Stamps a student version with the version of cotlearn and its master's hash, in place.

    Args:
        notebook: The student version that otter made.
        master: The path of the master that it was made from.
    """
    name, version = master.stem, cotlearn.__version__
    stamp = {"assignment": name, "version": version, "master": fingerprint(master)}
    notebook.metadata |= METADATA | {"otter": {"assignment_name": name}, "cotlearn": stamp}
    minor = ".".join(version.split(".")[:2])
    notebook.cells.append(
        nbformat.v4.new_markdown_cell(
            f"*Made with cotlearn {version}. The helpers that this notebook imports keep their "
            f"names in all versions {minor}.x.*",
            metadata={"tags": ["stamp"]},
        )
    )
    questions = {item.answer: item.name for item in assignments.read(master, name).questions}
    for i, cell in enumerate(notebook.cells):
        cell["id"] = f"{name}-{i:02d}"
        tags = [tag for tag in cell.metadata.get("tags", []) if not tag.startswith("otter")]
        kept = {"alt": cell.metadata["alt"]} if "alt" in cell.metadata else {}
        cell.metadata = nbformat.from_dict(kept | ({"tags": tags} if tags else {}))
        if "exercise" in tags:
            asked = next(q for answer, q in questions.items() if f"def {answer}(" in cell.source)
            cell.metadata["cotlearn"] = {"question": asked}
    return notebook


def fingerprint(master: Path) -> str:
    """Returns a short hash of a master's cells; outputs and metadata do not change it."""
    text = "\0".join(f"{cell.cell_type}\0{cell.source}" for cell in read(master).cells)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _assign(master: Path, out: Path) -> tuple[Any, Path]:
    """Runs otter; returns the student version and the path of the version with solutions."""
    target = out / "autograder" / master.stem
    shutil.rmtree(target, ignore_errors=True)
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "made"
        _otter("assign", "--no-pdfs", master, made)
        shutil.copytree(made / "autograder", target)
        return read(made / "student" / master.name), target / master.name


def _otter(*words: str | Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "otter", *map(str, words)],
        capture_output=True,
        text=True,
        env={**os.environ, "COTLEARN_PROGRESS": "0", "MPLBACKEND": "agg"},
        check=False,
    )
    if done.returncode != 0:
        raise ValueError(f"otter {words[0]} failed:\n{(done.stderr or done.stdout)[-3000:]}")


def _points_by_otter(name: str, out: Path) -> float:
    """The points that otter gives the unchanged student version."""
    file = next((out / "autograder" / name).glob("*.zip"))
    with tempfile.TemporaryDirectory() as folder:
        student = out / "student" / f"{name}.ipynb"
        _otter("run", "-a", file, "-o", folder, "--no-logo", student)
        results = json.loads((Path(folder) / "results.json").read_text(encoding="utf-8"))
    return float(sum(test.get("score") or 0 for test in results["tests"]))


def _try(name: str, out: Path, solutions: Path, say: Callable[[str], None]) -> None:
    """Checks that the solutions get all points and the unchanged stubs none."""
    right = mark(solutions, hidden=True, masters=out / "masters")
    stubs = mark(out / "student" / f"{name}.ipynb", hidden=True, masters=out / "masters")
    wrong = [f"{item.question}: {item.sentence}" for item in right.marks if not item.correct]
    for item in stubs.marks:
        if item.verdict != "not attempted yet" or item.points:
            counts = f"{item.verdict}, {item.points:g} points"
            wrong.append(f"{item.question}: the unchanged stub counts as {counts}")
    if by_otter := _points_by_otter(name, out):
        wrong.append(f"otter gives the unchanged stubs {by_otter:g} points")
    if wrong or not right.out_of:
        raise ValueError(f"{name}: " + ("; ".join(wrong) or "no hidden test has points"))
    points = f"the solutions get {right.points:g} of {right.out_of:g} points"
    say(f"{name}: {points}, the unchanged stubs 0, by otter and by cotlearn grade")


def _write(path: Path, notebook: Any) -> None:
    write_text(path, nbformat.writes(notebook).rstrip("\n") + "\n")
