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


def decide_by(errors):
    """The rule with another number of standard errors."""

    def answer(scores, flagged):
        name = best(scores, flagged)
        gain = scores["independent"] - scores[name]
        ahead = gain.mean() > errors * gain.std() / np.sqrt(len(gain))
        return name if ahead else "independent"

    return answer


def first_ahead(scores, flagged):
    """The first that is better than independent pairs, and not the best."""
    free = scores["independent"].mean()
    ahead = (name for name, row in clean(scores, flagged).items() if row.mean() < free)
    return next(ahead, "independent")


def surest(scores, flagged):
    """The one that is ahead by the most standard errors, and not the best."""
    free = scores["independent"]
    gains = {name: free - row for name, row in clean(scores, flagged).items() if row is not free}
    sure = {name: gain.mean() / gain.std() * np.sqrt(len(gain)) for name, gain in gains.items()}
    name = max(sure, key=sure.get)
    return name if sure[name] > 2 else "independent"


def or_equal(scores, flagged):
    name = best(scores, flagged)
    gain = scores["independent"] - scores[name]
    return name if gain.mean() >= 2 * gain.std() / np.sqrt(len(gain)) else "independent"


right = decide_by(2)


def flags_last(scores, flagged):
    return "independent" if best(scores) in flagged else right(scores, flagged)


MISTAKES = [
    *[("12.decide", decide_by(k), "not by two") for k in (0, 1, 1.645)],
    *[("12.decide", decide_by(k), "ahead by 2.2") for k in (2.58, 3)],
    ("12.decide", or_equal, "not by two"),
    ("12.decide", decide_by(10), "std / sqrt(n)"),  # the square root of n forgotten
    ("12.decide", flags_last, "without a flag"),
    ("12.decide", first_ahead, "strata is better still"),
    ("12.decide", surest, "strata is better still"),
    ("12.decide", lambda s, f: right({k: s.pop(k) for k in [*s]}, f), "changed its inputs"),
    ("12.guided", lambda a, b, s: b - s * (a - b), "with the label minus without"),
    ("12.guided", lambda a, b, s: a, "scale is not used"),
    ("12.decide", lambda s, f: best(s), "is flagged"),
    ("12.decide", best, "not by two"),
    ("12.decide", worst, "small scores are good"),
    ("12.decide", unpaired, "row by row"),
    ("12.decide", lambda s, f: "independent", "9.0 standard errors"),
    ("12.decide", lambda s, f: "other", "expected"),
    ("12.decide", "strata", "expected a function"),
    ("12.guided", lambda a, b, s: a + s * (a - b), "scale + 1"),
    ("12.guided", lambda a, b, s: a + s * (b - a), "scale 1 is the velocity with"),
    ("12.guided", lambda a, b, s: s * a, "without the label is needed"),
    ("12.guided", lambda a, b, s: b + s * a, "difference of the two"),
    ("12.guided", lambda a, b, s: a[:1], "shape"),
    ("12.guided", lambda a, b, s: b - a, "expected"),
]


RIGHT = [
    ("12.decide", right),
    ("12.decide", decide_by(1.96)),
    ("12.guided", lambda a, b, s: (1 - s) * b + s * a),
]
