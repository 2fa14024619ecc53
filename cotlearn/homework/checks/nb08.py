"""The checks of notebook 08."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from cotlearn.homework.checks.common import Case, Cases, expect_function, table
from cotlearn.homework.registry import NotYet

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


def _words(rule: Callable[[float, float, float], Any]) -> list[Any]:
    return [rule(*interval) for interval in _INTERVALS]


@table("08.verdict")
def verdict() -> Cases:
    """Non-inferiority from an interval of a difference."""

    def read(answer: Any) -> list[Any]:
        expect_function(answer)
        said = _words(answer)
        for word in said:
            if word not in ("shown", "refuted", "open"):
                raise NotYet(f"return one of the words 'shown', 'refuted' and 'open', got {word!r}")
        return said

    def otherwise(said: list[Any]) -> str:
        (low, high, margin), expected, got = next(
            row for row in zip(_INTERVALS, right, said, strict=True) if row[1] != row[2]
        )
        return (
            f"for a difference between {low} and {high} and a margin of {margin} expected "
            f"{expected!r}, got {got!r}"
        )

    right = _words(_verdict)
    wrong = {
        "that compares with 0; a loss of less than the margin is allowed: compare with -margin": (
            _words(lambda low, high, margin: _verdict(low, high, 0.0))
        ),
        "that asks for a gain of more than the margin: the line lies at -margin": (
            _words(lambda low, high, margin: _verdict(low, high, -margin))
        ),
        "an interval may contain 0 and still lie wholly above -margin: then it is shown": (
            _words(lambda low, high, m: "open" if low < 0 < high else _verdict(low, high, m))
        ),
        "the whole interval has to lie above -margin, so it is the lower end that decides": (
            _words(lambda low, high, margin: _verdict(high, low, margin))
        ),
        "the middle alone says nothing about how sure we are: use both ends": (
            _words(lambda low, high, margin: _verdict((low + high) / 2, (low + high) / 2, margin))
        ),
        "an interval that contains -margin decides nothing: that is 'open'": (
            _words(lambda low, high, margin: "shown" if low > -margin else "refuted")
        ),
    }
    yield Case(None, right, wrong, otherwise, read=read)


@table("08.choose")
def choose() -> Cases:
    """The smallest one-step variance without significant skew, else the least skew."""
    yield chosen(
        ("naive", 0.12, True, 14.0),
        ("64", 0.017, False, 17.0),
        ("512", 0.006, False, 18.5),
        ("independent", -0.001, False, 20.4),
    )
    yield chosen(
        ("independent", -0.002, False, 20.0),
        ("64", 0.06, True, 16.0),
        ("512", 0.01, False, 18.1),
        ("4096", 0.003, False, 19.7),
    )
    yield chosen(("a", 0.3, True, 2.0), ("b", 0.1, True, 3.0), ("c", 0.2, True, 1.0))


def chosen(*rows: tuple[str, float, bool, float]) -> Case:
    """A frontier to choose from, of rows (name, skew, flagged, one-step variance)."""
    columns = "name", "skew", "flagged", "one_step_variance"
    points = [SimpleNamespace(**dict(zip(columns, row, strict=True))) for row in rows]
    clean = [point for point in points if not point.flagged]
    least = min(points, key=lambda point: abs(point.skew)).name
    wrong: dict[str, Any] = {"return the name of the point, not the point": points.__contains__}
    if not clean:
        hint = f"where all points are flagged take the least skewed, {least!r}"
        return Case((points,), least, wrong, hint)
    first = min(points, key=lambda point: point.one_step_variance).name
    wrong["that point is flagged: leave out those with significant skew first"] = first
    wrong[
        "among points without a flag the differences of skew are chance: it is the smallest "
        "one-step variance that counts, not the skew"
    ] = least
    right = min(clean, key=lambda point: point.one_step_variance).name
    return Case((points,), right, wrong)
