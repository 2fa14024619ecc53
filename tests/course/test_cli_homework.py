"""`cotlearn check`, `progress`, `grade` and `homework`."""

from pathlib import Path

import handed_in
import pytest
from handed_in import EULER
from typer.testing import CliRunner

from cotlearn.cli import app
from cotlearn.course import assets, record, release

SAID = """: checking ...
✓ hw1.loss
✗ hw1.euler: your function euler ended Python (exit or quit); use return to leave a function
· hw1.exact_velocity: not attempted yet
✓ hw1.squared_w2
2 of 4 correct
"""


@pytest.fixture(autouse=True)
def _own_progress(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "file", lambda: tmp_path / "progress.json")


def run(*words):
    result = CliRunner().invoke(app, [str(word) for word in words])
    return result.exit_code, result.output


@pytest.mark.slow
def test_check_and_progress(tmp_path):
    path = tmp_path / "mein hw1 für Zoë.ipynb"
    leaves = EULER.replace("x = x0", "exit()\n    x = x0")
    handed_in.write(path, handed_in.homework(handed_in.answers(euler=leaves)))
    code, text = run("check", path)
    assert (code, text) == (1, f"{path.name}{SAID}")
    code, text = run("progress")
    assert code == 0
    assert "Homework 1 · Flow matching from scratch" in text
    assert "2 of 4  ✓ ✗ · ✓" in text
    assert "next: 00.self_test in 00_start_here.ipynb" in text


@pytest.mark.slow
def test_it_is_said_which_of_two_copies_is_checked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path("mine") / "hw1.ipynb"
    path.parent.mkdir()
    handed_in.write(path, handed_in.homework({}))
    assert run("check", path)[1].startswith(f"{path}: checking")


def test_what_cannot_be_checked(tmp_path):
    code, text = run("check", tmp_path / "hw1.ipynb")
    assert (code, "no notebook" in text) == (2, True)
    (tmp_path / "hw1.ipynb").write_text("no")
    code, text = run("check", tmp_path / "hw1.ipynb")
    assert (code, "hw1.ipynb is not a readable notebook" in text) == (2, True)


def test_grade(tmp_path):
    work = tmp_path / "work"
    work.mkdir()
    code, text = run("grade", work, "--out", tmp_path / "grades.csv")
    assert (code, "there is no notebook" in text) == (2, True)
    (work / "bad.ipynb").write_text("{")
    code, text = run("grade", work, "--out", tmp_path / "grades.csv")
    assert code == 0
    lines = ["loading the tests ...", f"reading the files in {work} ...", "bad.ipynb: it is not"]
    assert [
        line[: len(said)] for line, said in zip(text.splitlines(), lines, strict=False)
    ] == lines
    assert "(1 of 1)\n" in text
    assert "1 files: 0 known from before, 1 not gradable" in text
    assert (tmp_path / "grades.csv").exists()


def test_homework_can_be_made_again(tmp_path, monkeypatch):
    """It refused the folder that it had made before."""
    made = []
    monkeypatch.setattr(release, "make", lambda out, **options: made.append(out))
    (tmp_path / "masters").mkdir()
    (tmp_path / "masters" / "hw1.ipynb").write_text("{}")
    assert run("homework", "--out", tmp_path) == (0, "")
    assert made == [tmp_path]


def test_a_course_without_notebooks(tmp_path, monkeypatch):
    monkeypatch.setattr(assets, "course_folder", lambda: tmp_path)
    code, text = run("progress")
    assert (code, "no notebooks in" in text) == (2, True)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.ipynb").write_text("{")
    code, text = run("grade", tmp_path / "in", "--out", tmp_path / "grades.csv")
    assert (code, "there is no master notebook" in text) == (2, True)


def test_names_cannot_steer_the_terminal(tmp_path):
    path = tmp_path / "\x1b[31m.ipynb"
    path.write_text("{")
    text = run("check", path)[1]
    assert r"\x1b[31m" in text
    assert "\x1b" not in text
