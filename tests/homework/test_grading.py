"""Grading folders: resumable, and one bad file loses nothing."""

import csv
import os
import signal
import sys
from pathlib import Path

import handed_in
import pytest
from handed_in import EULER, PAIR
from waiting import until

from cotlearn.homework import grading
from cotlearn.homework.isolation import Limits

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("key")]
LIMITS = Limits(seconds=1, gigabytes=1)
EACH = ["4", "4", "0", "4"]  #: points of `handed_in.answers`
POINTS = ["12", "17", "71"]


def grade(folder, out, **options):
    return grading.grade(folder, out, workers=2, limits=LIMITS, **options)


def table(out):
    with out.open(encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def folder(tmp_path):
    """Handed-in work: good, bad, damaged, and with names of all kinds."""
    good = handed_in.homework(handed_in.answers())
    bad = handed_in.homework(handed_in.answers(loss=f"{PAIR}\nexit()", euler=f"{EULER}\n1 / 0"))
    made = tmp_path / "handed in"
    handed_in.write(made / "Zoë Müller" / "hw1.ipynb", good)
    handed_in.write(made / "Ann" / "hw1.ipynb", bad)
    handed_in.write(made / "=1+1.ipynb", good)
    (made / "damaged.ipynb").write_text("{")
    (made / "empty.ipynb").touch()
    (made / "no.ipynb").mkdir()
    handed_in.write(made / ".ipynb_checkpoints" / "hw1-checkpoint.ipynb", good)
    (made / "report.pdf").touch()
    return made


def test_a_folder(folder, tmp_path):
    out = tmp_path / "grades.csv"
    rows = grade(folder, out)
    found = {row["file"]: row for row in table(out)}
    work = ["'=1+1.ipynb", "Ann/hw1.ipynb", "Zoë Müller/hw1.ipynb"]
    assert list(found) == [*work, "damaged.ipynb", "empty.ipynb", "no.ipynb", "report.pdf"]
    best = found["Zoë Müller/hw1.ipynb"]
    assert [best[k] for k in ("assignment", "points", "out_of", "percent")] == ["hw1", *POINTS]
    assert [best[f"hw1.{name}"] for name in handed_in.NAMES] == EACH
    assert found["Ann/hw1.ipynb"]["hw1.loss"] == "0"
    assert "not a readable notebook" in found["damaged.ipynb"]["note"]
    assert found["damaged.ipynb"]["points"] == "0"

    feedback = (tmp_path / "grades" / "Ann" / "hw1.md").read_text(encoding="utf-8")
    assert "ended Python (exit or quit)" in feedback
    assert "line 6, raised ZeroDivisionError" in feedback
    assert (tmp_path / "grades" / "damaged.md").read_text().startswith("# damaged.ipynb")

    # again: all that was marked is known, and the table is the same
    again = grade(folder, out)
    assert sum(row.kept for row in again) == sum(bool(row.marked.marks) for row in again) == 3
    assert [row.marked for row in again] == [row.marked for row in rows]

    # a student hands in again: that one is graded anew
    handed_in.write(folder / "Ann" / "hw1.ipynb", handed_in.homework(handed_in.answers()))
    zoe = grading._Known(tmp_path / "grades" / ".known", "")._path(Path("Zoë Müller/hw1.ipynb"))
    zoe.write_text("{")  # and a torn file
    seen = []
    rows = grade(folder, out, each=lambda row, done, total: seen.append((done, total)))
    anew = {row.file for row in rows if row.marked.marks and not row.kept}
    assert anew == {"Ann/hw1.ipynb", "Zoë Müller/hw1.ipynb"}
    assert seen[-1] == (7, 7)


def test_an_empty_folder(tmp_path):
    out = tmp_path / "grades.csv"
    with pytest.raises(ValueError, match="there is no notebook"):
        grade(tmp_path, out)
    with pytest.raises(ValueError, match="folder must be a folder of notebooks"):
        grade(tmp_path / "nowhere", out)
    with pytest.raises(ValueError, match=r"out must be a file such as grades\.csv"):
        grade(tmp_path, tmp_path)
    assert not out.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="no kill -9")
def test_a_run_that_is_killed_goes_on(begun, tmp_path):
    work, out = tmp_path / "work", tmp_path / "grades.csv"
    sleepy = f"{PAIR}\nwhile True: pass"
    for name, change in (("a", {}), ("b", {}), ("c", {"loss": sleepy})):
        handed_in.write(work / f"{name}.ipynb", handed_in.homework(handed_in.answers(**change)))
    words = ["grade", str(work), "--out", str(out), "--workers", "1", "--seconds", "1"]
    process = begun([*words, "--gigabytes", "1"], dict(os.environ))
    known = tmp_path / "grades" / ".known"
    until(lambda: len(list(known.glob("*.json"))) >= 2, patience=600)
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert not out.exists()
    kept = {path: path.read_text() for path in known.glob("*.json")}

    assert [row.kept for row in grade(work, out)] == [True, True, False]
    assert {path: path.read_text() for path in kept} == kept
    assert [row["hw1.euler"] for row in table(out)] == [EACH[1]] * 3
    assert [row["hw1.loss"] for row in table(out)] == ["4", "4", "0"]
