"""The checks of notebook 08."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from cotlearn.homework.checks.common import Array, Case, Cases, call, table
from cotlearn.homework.registry import NotYet


@table("08.verdict")
def verdict() -> Cases:
    """The verdict on non-inferiority from the confidence interval of a difference."""
    low = np.array([-0.01, -0.05, -0.06, -0.015, 0.01, -0.03, -0.30, 0.005, -0.04])
    high = np.array([0.02, 0.01, -0.03, -0.005, 0.03, -0.01, 0.25, 0.012, -0.01])
    margin = np.array([0.02] * 8 + [0.05])
    cases = np.column_stack([low, high, margin]).tolist()

    def words(low: Array, high: Array, margin: Array | float) -> list[str]:
        return np.select([low > -margin, high < -margin], ["shown", "refuted"], "open").tolist()

    def read(answer: Any) -> list[str]:
        said = [call(answer, *case) for case in cases]
        for word in said:
            if word not in ("shown", "refuted", "open"):
                raise NotYet(f"return one of the words 'shown', 'refuted' and 'open', got {word!r}")
        return said

    def otherwise(said: list[str]) -> str:
        k = next(k for k, word in enumerate(said) if word != right[k])
        where = "for a difference between {} and {} and a margin of {}".format(*cases[k])
        return f"{where} expected {right[k]!r}, got {said[k]!r}"

    right, middle = words(low, high, margin), (low + high) / 2
    around_0 = ["open" if a < 0 < b else word for (a, b, _), word in zip(cases, right, strict=True)]
    swapped = words(high, low, margin)
    never_open = ["shown" if a > -m else "refuted" for a, _, m in cases]
    wrong = {
        "that compares with 0; a loss below the margin will do: use -margin": words(low, high, 0),
        "that asks for a gain above the margin: the line is -margin": words(low, high, -margin),
        "an interval may contain 0 and still lie above -margin: then it is shown": around_0,
        "all of the interval must lie above -margin: the lower end decides": swapped,
        "the middle says nothing of how sure we are: use both ends": words(middle, middle, margin),
        "an interval that contains -margin decides nothing: that is 'open'": never_open,
    }
    yield Case(None, right, wrong, otherwise, read=read)


@table("08.choose")
def choose() -> Cases:
    """The point of smallest one-step variance without significant skew, else of least skew."""
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
    """A case with a frontier to choose from: rows (name, skew, flagged, one-step variance)."""
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
    chance = "differences without a flag are chance: the one-step variance counts, not the skew"
    wrong[chance] = least
    right = min(clean, key=lambda point: point.one_step_variance).name
    return Case((points,), right, wrong)
