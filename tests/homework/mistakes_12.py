"""Wrong answers to the exercises of notebook 12, words of their hints, right ones."""

import numpy as np


def clean(scores, flagged):
    return {name: values for name, values in scores.items() if name not in flagged}


def best(scores, flagged=()):
    left = clean(scores, flagged)
    return min(left, key=lambda name: left[name].mean())


def worst(scores, flagged):
    left = clean(scores, flagged)
    return max(left, key=lambda name: left[name].mean())


def unpaired(scores, flagged):
    name = best(scores, flagged)
    free, other = scores["independent"], scores[name]
    error = np.sqrt((free.var() + other.var()) / len(free))
    return name if free.mean() - other.mean() > 2 * error else "independent"


MISTAKES = [
    ("12.decide", lambda s, f: best(s), "is flagged"),
    ("12.decide", best, "two standard errors"),
    ("12.decide", worst, "small scores are good"),
    ("12.decide", unpaired, "row by row"),
    ("12.decide", lambda s, f: "independent", "many standard errors"),
    ("12.decide", lambda s, f: "other", "expected"),
    ("12.decide", "strata", "expected a function"),
    ("12.guided", lambda a, b, s: a + s * (a - b), "scale + 1"),
    ("12.guided", lambda a, b, s: a + s * (b - a), "scale 1 is the velocity with"),
    ("12.guided", lambda a, b, s: s * a, "without the label is needed"),
    ("12.guided", lambda a, b, s: b + s * a, "difference of the two"),
    ("12.guided", lambda a, b, s: a[:1], "shape"),
    ("12.guided", lambda a, b, s: b - a, "expected"),
]


def right(scores, flagged):
    name = best(scores, flagged)
    gain = scores["independent"] - scores[name]
    return name if gain.mean() > 2 * gain.std() / np.sqrt(len(gain)) else "independent"


RIGHT = [("12.decide", right), ("12.guided", lambda a, b, s: (1 - s) * b + s * a)]
