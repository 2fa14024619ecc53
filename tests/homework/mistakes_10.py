"""Wrong answers to the exercises of notebook 10, words of their hints, right ones."""

import numpy as np

from cotlearn.metrics import mode_entropy


def entropy(ways):
    counts = np.unique(ways, return_counts=True)[1]
    share = counts / counts.sum()
    return -(share * np.log(share)).sum() if len(ways) else 0.0


def by_share(modes):
    with np.errstate(all="ignore"):
        share = np.stack([(modes == way).mean(axis=1) for way in range(3)])
        return -(share * np.log(share)).sum(axis=0).mean()


def clean(points):
    return [p for p in points if not p.flagged]


def least(points, what):
    return min(points, key=lambda p: getattr(p, what)).name


MISTAKES = [
    ("10.ways_entropy", lambda m: -mode_entropy(m), "minus sign"),
    ("10.ways_entropy", lambda m: mode_entropy(m) / np.log(2), "np.log2"),
    ("10.ways_entropy", lambda m: np.exp(mode_entropy(m)), "perplexity"),
    ("10.ways_entropy", lambda m: mode_entropy(m) / np.log(3), "not normalised"),
    ("10.ways_entropy", lambda m: np.mean([entropy(row) for row in m]), "-1 is a failure"),
    ("10.ways_entropy", lambda m: entropy(m[m >= 0]), "start by start"),
    (
        "10.ways_entropy",
        lambda m: np.mean([entropy(row[row >= 0]) for row in m if (row >= 0).any()]),
        "counts, with entropy 0",
    ),
    ("10.ways_entropy", lambda m: mode_entropy(m) * len(m), "not the sum"),
    ("10.ways_entropy", by_share, "0 log 0"),
    ("10.ways_entropy", lambda m: 0.5, "expected"),
    ("10.ways_entropy", lambda m: m, "one number"),
    ("10.ways_entropy", 1.0, "expected a function"),
    ("10.choose", lambda ps: least(ps, "one_step_variance"), "leave out those with"),
    ("10.choose", lambda ps: least(clean(ps) or ps, "one_step_variance"), "all points are flagged"),
    ("10.choose", lambda ps: least(ps, "skew"), "not the skew"),
    ("10.choose", lambda ps: "z", "expected"),
    ("10.choose", "c", "expected a function"),
]


def the_point(points):
    best = clean(points)
    if best:
        return min(best, key=lambda p: p.one_step_variance)
    return min(points, key=lambda p: p.skew)


RIGHT = [("10.ways_entropy", mode_entropy), ("10.choose", the_point)]
