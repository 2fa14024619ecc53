"""What happens in the kernel, done here: solutions get all points, and stubs none."""

import sys

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


@pytest.mark.slow
@pytest.mark.parametrize("name", MASTERS)
def test_solutions_get_all_points(shell, name, monkeypatch):
    found = judged(shell, MASTERS[name], name, monkeypatch)
    assert found == ({Verdict.CORRECT}, POINTS[name])


@pytest.mark.slow
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


NOISE = "the noise must not be changed: x = x + ..., not x += ..."
FIELD = "velocity(torch.zeros(len(x0)), x0)"
#: Answers, and what the test of the noise says of them.
COMPLAINTS = {
    "error": ('raise ValueError("oh")', "your answer raised ValueError: oh"),
    "assert": ("assert nfe < 0, nfe", "your answer raised AssertionError: 7"),
    "callback": ("x0 += 1; velocity(1)", "your answer raised TypeError"),
    "noise": (f"x0 += {FIELD}; return x0", NOISE),
    "value": (f"return x0 + 2 * {FIELD}", "a constant velocity of 1 must add 1 to the noise"),
    "kind": (
        "return 3",
        "what your answer returned does not fit: the hidden test raised",
    ),
}


@pytest.mark.parametrize("name", COMPLAINTS)
def test_a_hint_is_for_its_cause(shell, name):
    code, words = COMPLAINTS[name]
    exec(f"import torch\ndef euler(velocity, x0, nfe):\n    {code}", shell.user_ns)
    test = assignments.find("hw1").questions[1].tests[1]
    inside.test(test.source, test.hint)
    [[complaint]] = shell.shown
    assert complaint.startswith(words)
    assert (NOISE in complaint) == (name == "noise")


IMPORTS = {
    "plain": "from colorsys import rgb_to_hsv as turned",
    "time": "%%time\n\nimport colorsys, no_such_module",
    "inside": "import no_such_module\n!ls\ndef f():\n    import colorsys",
    "broken": "import colorsys\nthis fails",
}


@pytest.mark.parametrize("name", IMPORTS)
def test_imports_are_loaded_and_bind_nothing(shell, name, monkeypatch):
    monkeypatch.delitem(sys.modules, "colorsys", raising=False)
    before = set(shell.user_ns)
    inside.load(IMPORTS[name])
    assert ("colorsys" in sys.modules) == (name != "broken")
    assert set(shell.user_ns) == before


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
