"""Typical wrong answers get a sentence that helps, and no full marks; right ones count."""

import contextlib
import importlib
import inspect
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from cotlearn.course import assignments
from cotlearn.course.checking import NotYet, Verdict, exercises, find, judge
from cotlearn.course.checks import common

PATHS = sorted(Path(__file__).parent.glob("mistakes_*.py"))
MODULES = [importlib.import_module(path.stem) for path in PATHS]
MISTAKES = [item for module in MODULES for item in module.MISTAKES]
RIGHT = [item for module in MODULES for item in getattr(module, "RIGHT", [])]
MASTERS = [assignments.read(path, path.stem) for path in assignments.masters()]
QUESTIONS = {question.name: question for master in MASTERS for question in master.questions}


@pytest.mark.parametrize(("name", "answer", "hint"), MISTAKES)
def test_a_mistake_gets_a_hint(name, answer, hint):
    verdict, sentence = judge(answer, name)
    assert verdict is Verdict.NOT_YET, sentence
    assert hint in sentence


@pytest.mark.parametrize("name", exercises())
def test_every_row_of_a_table_is_reached(name, monkeypatch):
    """A hint that another row or the right result hides for three seeds would never be read."""
    cases: list[common.Case] = []
    check, run = find(name), common.run
    monkeypatch.setattr(common, "run", lambda answer, made: cases.extend(made))
    for seed in range(3 * ("seed" in inspect.signature(check).parameters)):
        with contextlib.suppress(NotYet):  # of plain checks, and of counted evaluations
            check(None, seed=seed)
    hints, reached = set(), set()
    for case in cases:
        for hint, wrong in case.wrong.items():
            if callable(wrong):
                continue
            hints.add(hint)
            try:
                run(None, iter([replace(case, given=None, read=lambda _, wrong=wrong: wrong)]))
            except NotYet as reason:
                reached.add(str(reason))
    assert hints <= reached


@pytest.mark.parametrize(("name", "answer"), RIGHT)
def test_other_right_answers_count(name, answer):
    assert judge(answer, name) == (Verdict.CORRECT, "correct")


def test_a_self_test_of_dots_is_not_attempted():
    dots = dict.fromkeys(["shape", "gradient", "best_constant", "mean", "euler"], ...)
    assert judge(dots, "00.self_test")[0] is Verdict.NOT_ATTEMPTED


@pytest.mark.parametrize(("name", "answer"), [m[:2] for m in MISTAKES if m[0] in QUESTIONS])
def test_a_mistake_fails_a_hidden_test(name, answer):
    failed = 0
    for test in QUESTIONS[name].tests:
        scope: dict[str, object] = {}
        exec(test.source, scope)
        function = [value for value in scope.values() if inspect.isfunction(value)][-1]
        try:
            function(answer)
        except Exception:
            failed += 1
    assert failed


def test_every_exercise_has_at_least_three():
    counts = Counter(name for name, *_ in MISTAKES)
    assert set(counts) == set(exercises())
    assert min(counts.values()) >= 3
