"""Wrong answers to the exercises of notebook 08, words of their hints, right ones."""

import torch
from scipy.optimize import linear_sum_assignment


def verdict(low, high, margin):
    if low > -margin:
        return "shown"
    return "refuted" if high < -margin else "open"


def best_of(rows, key):
    return max(rows, key=key, default={"name": "none"})["name"]


def fitting(budget, rows):
    return [row for row in rows if row["ms"] <= budget]


def within(budget, rows):
    return best_of(fitting(budget, rows), lambda row: (row["success"], -row["ms"]))


def plan(x0, x1, mean, *, power=2, sign=1, add=-1):
    cost = sign * torch.cdist(x0, x1 + add * mean) ** power
    return torch.from_numpy(linear_sum_assignment(cost)[1])


def variance(point):
    return point.one_step_variance


def least_variance(points):
    return min(points, key=variance)


def clean(points):
    return [p for p in points if not p.flagged]


def choose(points):
    by_skew = min(points, key=lambda p: p.skew)
    return (least_variance(clean(points)) if clean(points) else by_skew).name


MISTAKES = [
    ("08.verdict", lambda low, high, m: verdict(low, high, 0), "compares with 0"),
    ("08.verdict", lambda low, high, m: verdict(low, high, -m), "asks for a gain"),
    ("08.verdict", lambda a, b, m: "open" if a < 0 < b else verdict(a, b, m), "may contain 0"),
    ("08.verdict", lambda low, high, m: verdict(high, low, m), "lower end"),
    ("08.verdict", lambda low, high, m: verdict(*[(low + high) / 2] * 2, m), "the middle says"),
    ("08.verdict", lambda low, high, m: "shown" if low > -m else "refuted", "decides nothing"),
    ("08.verdict", lambda low, high, m: verdict(low + 1e-9, high, m), "expected 'open'"),
    ("08.verdict", lambda low, high, m: "open", "expected 'shown', got 'open'"),
    ("08.verdict", lambda low, high, m: low > -m, "one of the words"),
    ("08.verdict", "shown", "expected a function"),
    ("08.within", lambda ms, rows: best_of(rows, lambda r: r["success"]), "than the budget"),
    ("08.within", lambda *given: best_of(fitting(*given), lambda r: r["success"]), "equally good"),
    ("08.within", lambda *g: best_of(fitting(*g), lambda r: r["ms"]), "the slowest that fits"),
    ("08.within", lambda ms, rows: best_of(rows, lambda r: -r["ms"]), "the fastest is not"),
    ("08.within", lambda ms, rows: within(ms - 1e-9, rows), "use <="),
    ("08.within", lambda ms, rows: within(max(ms, 1), rows), "return 'none'"),
    ("08.within", lambda *g: within(*g) if fitting(*g) else None, "is a return missing?"),
    ("08.within", lambda ms, rows: rows.reverse() or within(ms, rows), "changed its inputs"),
    ("08.within", "D", "expected a function"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, add=0), "own mean"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m.mean(dim=0)), "changes no pair"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, add=1), "that adds the mean"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, sign=-1), "not large"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m, power=1), "square the distances"),
    ("08.centred_plan", lambda x0, x1, m: plan(x0, x1, m).argsort(), "the other way round"),
    ("08.centred_plan", lambda x0, x1, m: torch.arange(len(x0)), "not the pairs of least cost"),
    ("08.centred_plan", lambda x0, x1, m: torch.cdist(x0, x1 - m).argmin(dim=1), "is used once"),
    ("08.choose", lambda points: least_variance(points).name, "that point is flagged"),
    ("08.choose", lambda points: least_variance(points), "the name of the point"),
    ("08.choose", lambda points: min(points, key=lambda p: abs(p.skew)).name, "are chance"),
    ("08.choose", lambda points: points[-1].name, "are chance"),
    ("08.choose", lambda ps: max(clean(ps) or ps, key=variance).name, "not a large one"),
    ("08.choose", lambda points: "none", "expected '512'"),
    ("08.choose", lambda ps: least_variance(clean(ps) or ps).name, "take the least skewed, 'b'"),
    ("08.choose", lambda points: min([], key=len), "raised ValueError"),
    ("08.choose", 64, "expected a function"),
]


def _rank(point, points):
    return (point.flagged, point.one_step_variance) if clean(points) else (0, point.skew)


RIGHT = [
    ("08.verdict", lambda a, b, m: ["open", "shown", "refuted"][(a + m > 0) - (b + m < 0)]),
    ("08.verdict", verdict),
    ("08.within", within),
    ("08.centred_plan", plan),
    ("08.centred_plan", lambda *given: plan(*given).numpy()),
    ("08.choose", lambda points: sorted(points, key=lambda p: _rank(p, points))[0].name),
    ("08.choose", choose),
]
