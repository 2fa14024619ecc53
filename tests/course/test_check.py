import contextlib
import math
import signal
import time

import pytest
import torch

from cotlearn.course import check, checking
from cotlearn.course.checking import NotYet, Verdict, exercise, exercises


@pytest.fixture(autouse=True)
def _examples(monkeypatch):
    """Two exercises that exist only in these tests."""
    exercises()  # loads the real ones, which an import inside a test would lose
    monkeypatch.setattr(checking, "_registry", dict(checking._registry))

    @exercise("99.double")
    def _(answer):
        x = torch.arange(3.0)
        result = answer(x)
        if result.shape != x.shape:
            raise NotYet(f"expected the shape {tuple(x.shape)}, got {tuple(result.shape)}")
        if not torch.allclose(result, 2 * x):
            raise NotYet("the numbers are not twice those that went in")

    @exercise("99.two")
    def _(answer):
        if not math.isclose(answer, 2):
            raise NotYet(f"expected 2, got {answer}")


def not_implemented(x):
    raise NotImplementedError("your code here")


def only_dots(x):
    """Returns twice x."""
    ...


STUBS = [None, ..., (None, ...), not_implemented, only_dots]
STUBS += [lambda x: None, lambda x: ..., lambda x: (..., ...)]


@pytest.mark.parametrize("stub", STUBS)
def test_a_stub_is_not_attempted(stub, capsys):
    assert check(stub, "99.double") is Verdict.NOT_ATTEMPTED
    assert capsys.readouterr().out == "not attempted yet: 99.double\n"


def test_a_right_answer(capsys):
    assert check(lambda x: 2 * x, "99.double") is Verdict.CORRECT
    assert check(2, "99.two") is Verdict.CORRECT
    assert capsys.readouterr().out == "✓ correct\n✓ correct\n"


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (lambda x: x, "the numbers are not twice"),
        (lambda x: 2 * x[:1], r"expected the shape (3,), got (1,)"),
        (lambda x: x * math.nan, "the numbers are not twice"),
        (lambda x: 1 / 0, "raised ZeroDivisionError: division by zero"),
        (lambda: 0, "raised TypeError"),
        (lambda x: print(end=""), "returned None; is a return missing?"),
        (lambda x: [2 * v for v in x], "AttributeError: 'list' object has no attribute 'shape'"),
        ("2 * x", "TypeError: 'str' object is not callable"),
    ],
)
def test_a_wrong_answer_gets_a_sentence(answer, sentence, capsys):
    assert check(answer, "99.double") is Verdict.NOT_YET
    printed = capsys.readouterr().out
    assert printed.startswith("✗ not yet: ")
    assert sentence in " ".join(printed.split())
    assert max(map(len, printed.splitlines())) <= 80  # JupyterLab would break words


def test_an_endless_loop_is_stopped(monkeypatch, capsys):
    def endless(x):
        while True:
            with contextlib.suppress(Exception):
                time.sleep(0.01)

    monkeypatch.setattr(checking, "TIME_LIMIT", 0.2)
    assert check(endless, "99.double") is Verdict.NOT_YET
    assert "is there a loop that never ends?" in " ".join(capsys.readouterr().out.split())


def bare(x):
    while True:
        try:  # noqa: SIM105
            time.sleep(0.001)
        except:  # noqa: E722
            pass


def nested(x):
    while True:
        try:
            while True:
                try:
                    sum(range(1000))
                except:  # noqa: E722
                    continue
        except:  # noqa: E722
            pass


def in_the_end(x):
    while True:
        try:
            time.sleep(0.001)
        finally:
            continue  # noqa: B012


@pytest.mark.parametrize("answer", [bare, nested, in_the_end])
def test_a_loop_that_swallows_everything_is_stopped(monkeypatch, capsys, answer):
    """It went on for ever."""
    monkeypatch.setattr(checking, "TIME_LIMIT", 0.1)
    monkeypatch.setattr(checking, "WAITS", (0.05,))
    before = signal.getsignal(signal.SIGALRM)
    assert check(answer, "99.double") is Verdict.NOT_YET
    assert "is there a loop that never ends?" in " ".join(capsys.readouterr().out.split())
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)
    assert signal.getsignal(signal.SIGALRM) is before


def test_names():
    with pytest.raises(ValueError, match=r"no exercise '99\.doubel'; did you mean: 99\.double"):
        check(None, "99.doubel")
    with pytest.raises(ValueError, match="no exercise 'interpolate'"):
        check(None, "interpolate")
    with pytest.raises(TypeError, match="name must be a string"):
        check("99.double", lambda x: x)
    with pytest.raises(ValueError, match="must look like"):
        exercise("double")
    with pytest.raises(ValueError, match="already the name"):
        exercise("99.two")(print)


def test_a_verdict_adds_nothing_to_the_cell():
    assert Verdict.CORRECT._ipython_display_() is None


def test_all_exercises_are_found():
    assert {"99.double", "99.two"} <= set(exercises())
