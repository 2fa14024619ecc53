"""Wrong answers to the exercises of notebook 08, words of their hints, right ones."""

import torch
from scipy.optimize import linear_sum_assignment


def verdict(low, high, margin):
    if low > -margin:
        return "shown"
    return "refuted" if high < -margin else "open"


def choose(points):
    clean = [p for p in points if not p.flagged]
    if not clean:
        return min(points, key=lambda p: p.skew).name
    return min(clean, key=lambda p: p.one_step_variance).name


def within(budget, rows):
    fast = [row for row in rows if row["ms"] <= budget]
    best = max(fast, key=lambda row: (row["success"], -row["ms"]), default={"name": "none"})
    return best["name"]


def best_of(rows, key):
    return max(rows, key=key, default={"name": "none"})["name"]


def plan(x0, x1, mean, *, power=2, sign=1, add=-1):
    cost = sign * torch.cdist(x0, x1 + add * mean) ** power
    return torch.from_numpy(linear_sum_assignment(cost)[1])


def least_variance(points):
    return min(points, key=lambda p: p.one_step_variance)


def least_of_clean(points):
    return least_variance([p for p in points if not p.flagged] or points).name


MISTAKES = [
    ("08.verdict", lambda low, high, m: verdict(low, high, 0), "compares with 0"),
    ("08.verdict", lambda low, high, m: verdict(low, high, -m), "asks for a gain"),
    (
        "08.verdict",
        lambda low, high, m: "open" if low < 0 < high else verdict(low, high, m),
        "may contain 0",
    ),
    ("08.verdict", lambda low, high, m: verdict(high, low, m), "lower end"),
    ("08.verdict", lambda low, high, m: verdict(*[(low + high) / 2] * 2, m), "the middle says"),
    ("08.verdict", lambda low, high, m: "shown" if low > -m else "refuted", "decides nothing"),
    ("08.verdict", lambda low, high, m: "open", "expected 'shown', got 'open'"),
    ("08.verdict", lambda low, high, m: low > -m, "one of the words"),
    ("08.verdict", "shown", "expected a function"),
    ("08.within", lambda ms, rows: best_of(rows, lambda r: r["success"]), "than the budget"),
    (
        "08.within",
        lambda ms, rows: best_of([r for r in rows if r["ms"] <= ms], lambda r: r["success"]),
        "equally good",
    ),
    (
        "08.within",
        lambda ms, rows: best_of([r for r in rows if r["ms"] <= ms], lambda r: r["ms"]),
        "the slowest that fits",
    ),
    ("08.within", lambda ms, rows: best_of(rows, lambda r: -r["ms"]), "the fastest is not"),
    (
        "08.within",
        lambda ms, rows: within(ms - 1e-9, rows),
        "use <=",
    ),
    ("08.within", lambda ms, rows: within(max(ms, 1), rows), "return 'none'"),
    ("08.within", "D", "expected a function"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, add=0), "subtract the mean first"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, add=1), "that adds the mean"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, sign=-1), "not large"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, power=1), "square the distances"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m).argsort(), "the other way round"),
    ("08.centred_plan", lambda x0, x1, m: torch.arange(len(x0)), "not those of least cost"),
    (
        "08.centred_plan",
        lambda x0, x1, m: torch.cdist(x0, x1 - m).argmin(dim=1),
        "is used once",
    ),
    ("08.choose", lambda points: least_variance(points).name, "that point is flagged"),
    ("08.choose", lambda points: least_variance(points), "the name of the point"),
    ("08.choose", lambda points: min(points, key=lambda p: abs(p.skew)).name, "are chance"),
    ("08.choose", lambda points: points[-1].name, "are chance"),
    ("08.choose", lambda points: "none", "expected '64'"),
    ("08.choose", least_of_clean, "take the least skewed, 'b'"),
    ("08.choose", lambda points: min([], key=len), "raised ValueError"),
    ("08.choose", 64, "expected a function"),
]


def _rank(point, points):
    if all(p.flagged for p in points):
        return (0, point.skew)
    return (point.flagged, point.one_step_variance)


RIGHT = [
    (
        "08.verdict",
        lambda low, high, m: ["open", "shown", "refuted"][(low + m > 0) - (high + m < 0)],
    ),
    ("08.verdict", verdict),
    ("08.within", within),
    ("08.centred_plan", plan),
    ("08.centred_plan", lambda *given: plan(*given).numpy()),
    ("08.choose", lambda points: sorted(points, key=lambda p: _rank(p, points))[0].name),
    ("08.choose", choose),
]
