"""The checks of notebook 08."""

from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.course.checking import NotYet

from .common import Array, Case, Cases, call, cheapest, permutation, table


@table("08.verdict")
def verdict() -> Cases:
    """The verdict on non-inferiority from the confidence interval of a difference."""
    low = np.array([-0.01, -0.05, -0.06, -0.015, 0.01, -0.03, -0.30, 0.005, -0.04, -0.02])
    high = np.array([0.02, 0.01, -0.03, -0.005, 0.03, -0.01, 0.25, 0.012, -0.01, 0.01])
    margin = np.array([0.02] * 8 + [0.05, 0.02])
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
    wrong: dict[str, Any] = {
        "that compares with 0; a loss below the margin will do: use -margin": words(low, high, 0),
        "that asks for a gain above the margin: the line is -margin": words(low, high, -margin),
        "an interval may contain 0 and still lie above -margin: then it is shown": around_0,
        "all of the interval must lie above -margin: the lower end decides": swapped,
        "the middle says nothing of how sure we are: use both ends": words(middle, middle, margin),
        "an interval around -margin decides nothing: that is 'open'": lambda s: s[1] == "refuted",
    }
    yield Case(None, right, wrong, otherwise, read=read)


@table("08.within")
def within() -> Cases:
    """The name of the policy with the highest success within a budget; the faster one of equals."""
    rows: list[dict[str, Any]] = [
        {"name": "A", "ms": 40.0, "success": 0.99},
        {"name": "B", "ms": 1.0, "success": 0.20},
        {"name": "C", "ms": 5.0, "success": 0.97},
        {"name": "D", "ms": 2.0, "success": 0.97},
        {"name": "E", "ms": 8.0, "success": 0.60},
    ]
    for budget in (8.0, 5.0, 40.0, 1.0, 3.0, 0.5):
        right = best(row for row in rows if row["ms"] <= budget)
        wrong = {
            "that policy needs more milliseconds than the budget": "A",
            "those two are equally good: take the faster one": "C",
            "the slowest that fits is not always the best: compare success": "E",
            "the fastest is not always the best: compare success": "B",
        }
        if right == "none":
            wrong = {"none of the policies is fast enough: return 'none'": "B"}
        below = best(row for row in rows if row["ms"] < budget)
        wrong["'at most' includes the budget itself: use <="] = below
        yield Case((budget, rows), right, wrong)


def best(rows: Iterable[dict[str, Any]]) -> str:
    """The name of the row of the highest success, the faster one of equals."""
    key = {row["name"]: (row["success"], -row["ms"]) for row in rows}
    return max(key, key=key.__getitem__, default="none")


@table("08.centred_plan")
def centred_plan(g: torch.Generator) -> Cases:
    """The rows of x1 whose residuals are assigned to the rows of noise at the least cost."""
    for n in (12, 16):
        x0, noise, c = (torch.randn(n, 2, generator=g) for _ in range(3))
        mean = torch.stack([1.5 * c[:, 0], c[:, 1] ** 2], dim=1)
        x1 = mean + noise * torch.tensor([0.5, 2.0])
        right = cheapest(torch.cdist(x0, x1 - mean) ** 2)
        wrong = {
            "subtract each row's own mean (one for all changes no pair)": torch.cdist(x0, x1) ** 2,
            "that adds the mean: subtract it": torch.cdist(x0, x1 + mean) ** 2,
            "the squared distance is to be small, not large": -(torch.cdist(x0, x1 - mean) ** 2),
            "square the distances": torch.cdist(x0, x1 - mean),
        }
        plans = {hint: cheapest(cost) for hint, cost in wrong.items()}
        plans["entry i is the row of x1 for row i of x0, not the other way round"] = right.argsort()

        def read(value: Any, n: int = n) -> Tensor:
            return permutation(value, n, "each row of x1 is used once")

        yield Case((x0, x1, mean), right, plans, "these are not the pairs of least cost", read=read)


@table("08.choose")
def choose() -> Cases:
    """The point of smallest one-step variance without significant skew, else of least skew."""
    naive, independent = ("naive", 0.12, True, 14.0), ("independent", -0.001, False, 20.4)
    coarse, fine = ("64", 0.017, False, 21.0), ("512", 0.006, False, 18.5)
    flagged = [("a", 0.3, True, 2.0), ("b", 0.1, True, 3.0), ("c", 0.2, True, 1.0)]
    for rows in ([naive, coarse, fine, independent], [independent, naive, fine], flagged):
        columns = "name", "skew", "flagged", "one_step_variance"
        points = [SimpleNamespace(**dict(zip(columns, row, strict=True))) for row in rows]
        clean = [point for point in points if not point.flagged]
        least = min(points, key=lambda point: abs(point.skew)).name
        wrong: dict[str, Any] = {"return the name of the point, not the point": points.__contains__}
        hint = f"where all points are flagged take the least skewed, {least!r}"
        if clean:
            wrong["that point is flagged: leave out those with significant skew first"] = "naive"
            wrong["a small variance is good, not a large one"] = "64"
            chance = "differences without a flag are chance: the variance counts, not the skew"
            wrong[chance], hint = least, ""
        right = min(clean, key=lambda point: point.one_step_variance).name if clean else least
        yield Case((points,), right, wrong, hint)
