"""Wrong answers to the exercises of notebook 08, words of their hints, right ones."""


def verdict(low, high, margin):
    if low > -margin:
        return "shown"
    return "refuted" if high < -margin else "open"


def choose(points):
    clean = [p for p in points if not p.flagged]
    if not clean:
        return min(points, key=lambda p: p.skew).name
    return min(clean, key=lambda p: p.one_step_variance).name


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
    ("08.choose", lambda points: sorted(points, key=lambda p: _rank(p, points))[0].name),
    ("08.choose", choose),
]
