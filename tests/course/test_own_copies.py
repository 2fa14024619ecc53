"""Learners work in copies: made once, never overwritten, without the answers to predictions."""

import json
import os
import re
import subprocess
from pathlib import Path

import nbformat
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.course import assets, copies, record

LINK = re.compile(r"\]\((?!https?:|#)([^)#\s]+)")


@pytest.fixture
def course(tmp_path, monkeypatch):
    """A checkout of two notebooks, a side room and homework."""
    root = tmp_path / "a checkout"
    names = ["01_first", "02_second", "laboratory/01_aside", "homework/student/hw1"]
    for name in [*names, "homework/challenge"]:
        answer = new_output("stream", name="stdout", text="the answer\n")
        cells = [new_code_cell("1", execution_count=1, outputs=[answer])]
        path = root / "notebooks" / f"{name}.ipynb"
        path.parent.mkdir(parents=True, exist_ok=True)
        nbformat.write(new_notebook(cells=cells), path)
    monkeypatch.setattr(assets, "course_folder", lambda: root)
    monkeypatch.setattr(assets, "checkout", lambda: root)
    return root


ALL = ["01_first", "02_second", "hw1", "challenge", "laboratory/01_aside"]


def names(paths, folder):
    return [path.relative_to(folder).with_suffix("").as_posix() for path in paths]


def test_copies_are_made_once_and_never_overwritten(course):
    mine = copies.folder()
    assert mine == course / "my-course"
    copied, kept = copies.make(mine)
    assert (names(copied, mine), kept) == (ALL, [])
    (mine / "01_first.ipynb").write_text("my work")
    (course / "notebooks" / "03_new.ipynb").write_text('{"cells": []}')
    copied, kept = copies.make(mine)
    assert (names(copied, mine), len(kept)) == (["03_new"], 5)
    assert (mine / "01_first.ipynb").read_text() == "my work"
    with pytest.raises(ValueError, match="to must be a folder, got the file"):
        copies.make(mine / "01_first.ipynb")


@pytest.mark.parametrize("outputs", [False, True])
def test_copies_show_no_answers_unless_asked(course, tmp_path, outputs):
    copies.make(tmp_path / "mine", outputs=outputs)
    original = (course / "notebooks" / "01_first.ipynb").read_text()
    text = (tmp_path / "mine" / "01_first.ipynb").read_text()
    assert ("the answer" in text, text == original) == (outputs, outputs)
    nbformat.validate(nbformat.reads(text, as_version=4))


@pytest.mark.parametrize(
    ("name", "copy"),
    [
        ("1", "01_first"),
        ("01", "01_first"),
        ("01_first.ipynb", "01_first"),
        ("my-course/01_first.ipynb", "01_first"),
        ("laboratory/01", "laboratory/01_aside"),
        ("my-course/laboratory/01_aside.ipynb", "laboratory/01_aside"),
        ("hw1", "hw1"),
    ],
)
def test_a_copy_starts_over_and_the_old_one_is_kept(course, name, copy):
    mine = copies.folder()
    assert copies.renew(name, mine) == (mine / f"{copy}.ipynb", None)
    for number in (1, 2):
        (mine / f"{copy}.ipynb").write_text(f"work {number}")
        new, old = copies.renew(name, mine)
        assert names([new, old], mine) == [copy, f"{copy}.backup-{number}"]
        assert old.read_text() == f"work {number}"
        assert json.loads(new.read_text())["cells"]
    copies.make(mine)
    assert copies.find(name) == mine / f"{copy}.ipynb"


def test_what_is_no_notebook_starts_nothing_over(course):
    copies.make(copies.folder())
    with pytest.raises(ValueError, match="did you mean: 01_first"):
        copies.renew("01_frist", copies.folder())
    assert len(list(copies.folder().rglob("*.ipynb"))) == len(ALL)


def test_without_a_copy_the_courses_notebook_is_found(course):
    assert copies.find("01") == course / "notebooks" / "01_first.ipynb"
    with pytest.raises(ValueError, match="there is no notebook 'hw7'; did you mean: hw1"):
        copies.find("hw7")


@pytest.mark.parametrize(("name", "file"), [("hw1", "student/hw1"), ("challenge", "challenge")])
def test_homework_is_found_by_its_name_by_all_commands(course, name, file):
    """`cotlearn run hw1` said that there is none, and so did `check hw1` without a copy."""
    original = course / "notebooks" / "homework" / f"{file}.ipynb"
    assert copies.find(name) == copies.course_or_homework(f"{name}.ipynb") == original
    copies.make(copies.folder())
    own = copies.folder() / f"{name}.ipynb"
    assert copies.find(name) == copies.course_or_homework(name) == own
    numbered = course / "notebooks" / "01_first.ipynb"
    assert copies.course_or_homework("01") == numbered  # of these it is the course's
    with pytest.raises(ValueError, match="there is no notebook 'hw7'; did you mean: hw1"):
        copies.course_or_homework("hw7")


def test_links_lead_from_the_copies_to_the_same_places():
    root = assets.checkout()
    there = {root / copies.FOLDER / name for name in copies.originals()}
    for name, original in copies.originals().items():
        for cell in json.loads(original.read_text("utf-8"))["cells"]:
            links = LINK.findall("".join(cell["source"])) if cell["cell_type"] == "markdown" else []
            for link in links:
                target = Path(os.path.normpath(root / copies.FOLDER / Path(name).parent / link))
                assert target in there or target.exists(), f"{name}: {link}"
                assert "notebooks" not in target.parts, f"{name} leads away from the copies: {link}"


def test_git_does_not_see_the_copies():
    root = assets.checkout()
    command = ["git", "check-ignore", "my-course/00_start_here.ipynb"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    if done.returncode == 128:
        pytest.skip("no repository of git")
    assert done.stdout.strip() == command[-1]


@pytest.mark.slow
def test_check_and_grade_work_on_copies(tmp_path, monkeypatch):
    mine = tmp_path / "my-course"
    monkeypatch.setattr(copies, "folder", lambda: mine)
    monkeypatch.setattr(record, "file", lambda: tmp_path / "progress.json")
    copies.make(mine)
    path = mine / "00_start_here.ipynb"
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.source = cell.source.replace("perfect_one_step = ...", "perfect_one_step = 1.565")
    nbformat.write(notebook, path)
    result = CliRunner().invoke(cli.app, ["check", "00"])
    assert "1 of 3 correct" in result.output
    assert record.read()["00.perfect_one_step"]["verdict"] == "correct"
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "hw1.ipynb").write_bytes((mine / "hw1.ipynb").read_bytes())
    out = ["--out", str(tmp_path / "grades.csv")]
    result = CliRunner().invoke(cli.app, ["grade", str(tmp_path / "in"), *out])
    assert "hw1.ipynb: 0 of 17" in result.output
