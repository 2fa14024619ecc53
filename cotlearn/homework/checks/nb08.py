"""The checks of notebook 08."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from cotlearn.homework.registry import NotYet, exercise

_WORDS = ("shown", "refuted", "open")
_INTERVALS = (  # low, high, margin
    (-0.01, 0.02, 0.02),
    (-0.05, 0.01, 0.02),
    (-0.06, -0.03, 0.02),
    (-0.015, -0.005, 0.02),
    (0.01, 0.03, 0.02),
    (-0.03, -0.01, 0.02),
    (-0.30, 0.25, 0.02),
    (0.005, 0.012, 0.02),
    (-0.04, -0.01, 0.05),
)


def _verdict(low: float, high: float, margin: float) -> str:
    return "shown" if low > -margin else "refuted" if high < -margin else "open"


_SLIPS: tuple[tuple[Callable[[float, float, float], str], str], ...] = (
    (
        lambda low, high, margin: _verdict(low, high, 0.0),
        "that compares with 0; a loss of less than the margin is allowed: compare with -margin",
    ),
    (
        lambda low, high, margin: _verdict(low, high, -margin),
        "that asks for a gain of more than the margin: the line lies at -margin",
    ),
    (
        lambda low, high, margin: "open" if low < 0 < high else _verdict(low, high, margin),
        "an interval may contain 0 and still lie wholly above -margin: then it is shown",
    ),
    (
        lambda low, high, margin: _verdict(high, low, margin),
        "the whole interval has to lie above -margin, so it is the lower end that decides",
    ),
    (
        lambda low, high, margin: _verdict((low + high) / 2, (low + high) / 2, margin),
        "the middle alone says nothing about how sure we are: use both ends",
    ),
    (
        lambda low, high, margin: "shown" if low > -margin else "refuted",
        "an interval that contains -margin decides nothing: that is 'open'",
    ),
)


@exercise("08.verdict")
def verdict(answer: Any) -> None:
    """Non-inferiority from an interval of a difference."""
    if not callable(answer):
        raise NotYet(f"expected a function, got {type(answer).__name__}")
    said = [answer(*case) for case in _INTERVALS]
    for word in said:
        if not isinstance(word, str) or word not in _WORDS:
            raise NotYet(f"return one of the words 'shown', 'refuted' and 'open', got {word!r}")
    right = [_verdict(*case) for case in _INTERVALS]
    if said == right:
        return
    for slip, hint in _SLIPS:
        if said == [slip(*case) for case in _INTERVALS]:
            raise NotYet(hint)
    wrong = next(k for k, word in enumerate(said) if word != right[k])
    low, high, margin = _INTERVALS[wrong]
    raise NotYet(
        f"for a difference between {low} and {high} and a margin of {margin} expected "
        f"{right[wrong]!r}, got {said[wrong]!r}"
    )


def _point(name: str, skew: float, variance: float, flagged: bool) -> Any:
    return SimpleNamespace(name=name, skew=skew, one_step_variance=variance, flagged=flagged)


_FRONTIERS = (
    (
        _point("naive", 0.12, 14.0, True),
        _point("64", 0.017, 17.0, False),
        _point("512", 0.006, 18.5, False),
        _point("independent", -0.001, 20.4, False),
    ),
    (
        _point("independent", -0.002, 20.0, False),
        _point("64", 0.06, 16.0, True),
        _point("512", 0.01, 18.1, False),
        _point("4096", 0.003, 19.7, False),
    ),
    (_point("a", 0.3, 2.0, True), _point("b", 0.1, 3.0, True), _point("c", 0.2, 1.0, True)),
)


def _chosen(points: Any) -> str:
    clean = [p for p in points if not p.flagged]
    if clean:
        return str(min(clean, key=lambda p: p.one_step_variance).name)
    return str(min(points, key=lambda p: p.skew).name)


@exercise("08.choose")
def choose(answer: Any) -> None:
    """The smallest one-step variance without significant skew."""
    if not callable(answer):
        raise NotYet(f"expected a function, got {type(answer).__name__}")
    for points in _FRONTIERS:
        got, right = answer(list(points)), _chosen(points)
        if got == right:
            continue
        if got in points:
            raise NotYet("return the name of the point, not the point")
        if all(p.flagged for p in points):
            raise NotYet(f"where all points are flagged take the least skewed, {right!r}: {got!r}")
        if got == min(points, key=lambda p: p.one_step_variance).name:
            raise NotYet("that point is flagged: leave out those with significant skew first")
        if got == min(points, key=lambda p: abs(p.skew)).name:
            raise NotYet(
                "among points that are not flagged differences of skew are chance: take the "
                "smallest one-step variance"
            )
        raise NotYet(f"expected {right!r}, got {got!r}")
