"""What happens in the kernel, done here: solutions get all points, and stubs none."""

import handed_in
import matplotlib as mpl
import pytest
from IPython.core.interactiveshell import InteractiveShell

from cotlearn import course
from cotlearn.course import assignments, inside
from cotlearn.course.checking import Verdict
from cotlearn.course.execution import read

MASTERS = {path.stem: path for path in assignments.masters()}
POINTS = {"hw1": 17, "hw2": 14, "hw3": 14, "hw4": 14}


@pytest.fixture
def shell(monkeypatch):
    """A stand-in for the kernel's shell, and what was shown in it."""
    shell = InteractiveShell()
    monkeypatch.setattr(inside, "get_ipython", lambda: shell)
    shell.shown = []
    monkeypatch.setattr(inside, "display", lambda data, raw: shell.shown.append(*data.values()))
    yield shell
    shell.history_manager.end_session()


def judged(shell, path, name, monkeypatch):
    """The verdicts of a notebook's answers, and the points that they get."""
    monkeypatch.setattr(course, "check", lambda *given: None)
    monkeypatch.setattr(course, "passed", lambda *names: False)
    with mpl.rc_context({"backend": "agg"}):
        for cell in read(path).cells:
            if cell.cell_type == "code" and "TEST CONFIG" not in cell.source:
                exec(cell.source, shell.user_ns)
    verdicts, points = [], 0
    for asked in assignments.read(MASTERS[name], name).questions:
        inside.check(asked.name, asked.answer)
        verdicts.append(shell.shown[-1][0])
        for test in asked.tests:
            inside.test(test.source, test.hint)
            points += test.points if shell.shown[-1] == [""] else 0
    return set(verdicts), points


@pytest.mark.parametrize("name", MASTERS)
def test_solutions_get_all_points(shell, name, monkeypatch):
    found = judged(shell, MASTERS[name], name, monkeypatch)
    assert found == ({Verdict.CORRECT}, POINTS[name])


@pytest.mark.parametrize("name", MASTERS)
def test_stubs_get_none(shell, name, monkeypatch):
    path = MASTERS[name].parent / "student" / f"{name}.ipynb"
    assert judged(shell, path, name, monkeypatch) == ({Verdict.NOT_ATTEMPTED}, 0)


def test_an_answer_that_is_not_there(shell):
    inside.check("hw1.euler", "euler")
    assert shell.shown == [[None, ""]]


def test_only_the_self_check_is_content(shell):
    learned = handed_in.PAIR.replace("    place", "    if len(x0) > 5: return t\n    place")
    exec(f"import torch\n{learned}", shell.user_ns)
    [asked, *_] = assignments.find("hw1").questions
    inside.check(asked.name, asked.answer)
    for test in asked.tests:
        inside.test(test.source, test.hint)
    hint = "gradients must reach the network: do not detach the loss"
    assert shell.shown == [["correct", "correct"], [""], [hint]]


ACCIDENTS = {
    "sys.exit": ("import sys; sys.exit()", "ended Python (exit or quit)"),
    "error": ("1 / 0", "raised ZeroDivisionError: division by zero"),
    "recursion": ("euler()", "called itself without end"),
    "memory": ("import numpy as np; np.ones(int(12.5e12))", "asked for more memory"),
    "words": ('raise ValueError("\\ud800 \\x1b[2J")', r"raised ValueError: \ud800 \x1b[2J"),
}


@pytest.mark.parametrize("name", ACCIDENTS)
def test_an_accident_is_a_sentence(shell, name):
    code, words = ACCIDENTS[name]
    exec(f"def euler(*given):\n    {code}", shell.user_ns)
    inside.check("hw1.euler", "euler")
    inside.test("def test(euler):\n    euler()", "")
    [[verdict, sentence], [complaint]] = shell.shown
    assert verdict == Verdict.NOT_YET
    assert words in sentence
    assert words in complaint


def test_asserts_of_hidden_tests_stay(shell, monkeypatch):
    """As in `python -O`, where `compile` drops asserts unless it is told not to."""

    def optimised(source, name, mode, optimize=-1):
        return compile(source, name, mode, optimize=2 if optimize == -1 else optimize)

    monkeypatch.setattr(inside, "compile", optimised, raising=False)
    inside.test("def test(interpolate):\n    assert False", "wrong")
    assert shell.shown == [["wrong"]]
