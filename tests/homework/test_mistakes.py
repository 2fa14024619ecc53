"""Typical wrong answers to the homework get a sentence that helps, and no full marks."""

from __future__ import annotations

import inspect
from collections import Counter

import mistakes_hw1
import mistakes_hw2
import mistakes_hw3
import mistakes_hw4
import pytest

from cotlearn.homework import Verdict, assignments
from cotlearn.homework.registry import judge

MODULES = mistakes_hw1, mistakes_hw2, mistakes_hw3, mistakes_hw4
MISTAKES = [item for module in MODULES for item in module.MISTAKES]
QUESTIONS = {
    question.name: question
    for path in assignments.masters()
    for question in assignments.read(path, path.stem).questions
}


@pytest.mark.parametrize(("name", "answer", "hint"), MISTAKES)
def test_a_mistake_gets_a_hint(name, answer, hint):
    verdict, sentence = judge(answer, name)
    assert verdict is Verdict.NOT_YET, sentence
    assert hint in sentence


@pytest.mark.parametrize(("name", "answer"), [item[:2] for item in MISTAKES])
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


def test_every_question_has_at_least_three():
    counts = Counter(name for name, *_ in MISTAKES)
    assert set(counts) == set(QUESTIONS)
    assert min(counts.values()) >= 3
