"""Making the versions; otter-grader itself is used only where it is installed."""

import importlib.util

import nbformat
import pytest

from cotlearn.course import assignments, release
from cotlearn.course.execution import read
from cotlearn.course.marking import mark

OTTER = importlib.util.find_spec("otter") is not None
needs_otter = pytest.mark.skipif(not OTTER, reason="otter-grader is not installed")


def seeds(master):
    questions = assignments.read(master, master.stem).questions
    sources = [test.source for question in questions for test in question.tests]
    return [line for source in sources for line in source.splitlines() if " seed = " in line]


@pytest.mark.slow
def test_a_secret_changes_every_seed(tmp_path):
    master = assignments.masters()[0]
    made = {}
    for secret in (None, "one", "two", "one "):
        path = tmp_path / "hw1.ipynb"
        nbformat.write(release.seeded(read(master), "hw1", secret), path)
        made[secret] = seeds(path)
        if secret == "one":
            assert len(set(made[secret])) == len(made[secret]) == 8
            assert mark(path, hidden=True, masters=tmp_path).points == 17
    assert made[None] == seeds(master)
    for other in (None, "two", "one "):
        assert not set(made["one"]) & set(made[other])


def test_a_hidden_test_without_a_seed_is_an_error():
    notebook = read(assignments.masters()[0])
    for cell in notebook.cells:
        cell.source = cell.source.replace("seed = 2", "pass")
    with pytest.raises(ValueError, match="hw1 has no line 'seed"):
        release.seeded(notebook, "hw1", "secret")


@pytest.mark.skipif(OTTER, reason="otter-grader is installed")
def test_without_otter(tmp_path):
    with pytest.raises(ModuleNotFoundError, match="otter"):
        release.make(tmp_path)


@needs_otter
@pytest.mark.slow
def test_with_otter(tmp_path):
    masters = tmp_path / "masters"
    masters.mkdir()
    first = assignments.masters()[0]
    (masters / "hw1.ipynb").write_bytes(first.read_bytes())
    said = []
    release.make(tmp_path / "out", masters=masters, secret_seed="x y", say=said.append)
    assert "about a minute" in said.pop(0)
    assert said[0].startswith("hw1: the solutions get 17 of 17 points, the unchanged stubs 0,")
    student = tmp_path / "out" / "student" / "hw1.ipynb"
    released = first.parent / "student" / "hw1.ipynb"
    assert student.read_bytes() == released.read_bytes()
    assert list((tmp_path / "out" / "autograder" / "hw1").glob("hw1-autograder_*.zip"))
