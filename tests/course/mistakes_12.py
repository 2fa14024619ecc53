"""Wrong answers to the exercises of notebook 12, words of their hints, right ones."""

from math import ceil

import numpy as np
import torch
from sklearn.datasets import load_wine

from cotlearn.diagnostics import linear_skew


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


def kept(x1, y, paired_x1, paired_y):
    row = torch.cdist(paired_x1, x1).argmin(dim=1)
    return float((y[row] == paired_y).float().mean())


def told(x0, x1, c):
    noise, data = (float(linear_skew(x, c).explained) for x in (x0, x1))
    return noise * x0.shape[1], data


def diagnosis(factor=1.0, share=0.9, columns=True):
    """The rule with other thresholds, or with the share of the noise's variance."""

    def answer(x0, x1, c, plain, most):
        noise, data = told(x0, x1, c)
        skewed, lost = (noise if columns else noise / 4) > factor * most, data < share * plain
        return {(1, 1): "both", (1, 0): "skew", (0, 1): "labels"}.get((skewed, lost), "nothing")

    return answer


def wines():
    x1, sort = load_wine(return_X_y=True)
    return x1, sort


def measured(n=200, d=3, k=2):
    g = np.random.default_rng(0)
    return g.normal(size=(n, d)), g.normal(size=(n, k))


def with_itself():
    x1, c = measured()
    return x1, np.column_stack([c, 2 - 3 * x1[:, 1]])


def needed(ours, theirs, margin):
    return ceil((2 * (ours - theirs).std() / margin) ** 2)


MISTAKES = [
    *[("12.decide", decide_by(k), "not by two") for k in (0, 1, 1.645)],
    *[("12.decide", decide_by(k), "ahead by 2.2") for k in (2.58, 3)],
    ("12.decide", or_equal, "not by two"),
    ("12.decide", decide_by(10), "std / sqrt(n)"),  # the square root of n forgotten
    ("12.decide", flags_last, "without a flag"),
    ("12.decide", first_ahead, "strata is better still"),
    ("12.decide", surest, "strata is better still"),
    ("12.decide", lambda s, f: right({k: s.pop(k) for k in [*s]}, f), "changed its inputs"),
    ("12.decide", lambda s, f: best(s), "is flagged"),
    ("12.decide", best, "not by two"),
    ("12.decide", worst, "small scores are good"),
    ("12.decide", unpaired, "row by row"),
    ("12.decide", lambda s, f: "independent", "9.0 standard errors"),
    ("12.decide", lambda s, f: "other", "expected"),
    ("12.decide", "strata", "expected a function"),
    ("12.own_data", lambda: measured()[0], "return two arrays"),
    ("12.own_data", lambda: measured(100), "that is 100 rows; the trial needs 134"),
    ("12.own_data", lambda: (measured()[0], measured(180)[1]), "x1 has 200 rows, c has 180"),
    ("12.own_data", lambda: (np.ones((200, 2)), measured()[1]), "x1 does not vary"),
    ("12.own_data", lambda: (measured()[0], np.ones(200)), "tells nothing"),
    ("12.own_data", with_itself, "column 2 of c tells column 1 of x1"),
    ("12.own_data", lambda: (np.full((200, 2), np.nan), measured()[1]), "x1"),
    ("12.own_data", lambda: "flower.npz", "return two arrays"),
    ("12.own_data", measured(), "expected a function"),
    ("12.episodes_needed", lambda a, b, m: ceil(((a - b).std() / m) ** 2), "not one"),
    ("12.episodes_needed", lambda a, b, m: ceil(4 * (a.var() + b.var()) / m**2), "same episodes"),
    ("12.episodes_needed", lambda a, b, m: ceil(4 * a.var() / m**2), "of ours alone"),
    ("12.episodes_needed", lambda a, b, m: ceil(4 * (a != b).mean() / m**2), "square of their"),
    ("12.episodes_needed", lambda a, b, m: ceil(2 * (a - b).std() / m), "so square"),
    ("12.episodes_needed", lambda *given: needed(*given) - 1, "played whole"),
    ("12.episodes_needed", lambda a, b, m: (2 * (a - b).std() / m) ** 2, "a whole number"),
    ("12.episodes_needed", lambda *given: 2 * needed(*given), "solve that for n"),
    ("12.episodes_needed", lambda *given: "many", "number"),
    ("12.diagnosis", diagnosis(columns=False), "'skew'"),
    ("12.diagnosis", diagnosis(0.1), "'nothing'"),
    ("12.diagnosis", diagnosis(share=0.2), "'labels'"),
    ("12.diagnosis", lambda *given: "skew", "'nothing'"),
    ("12.diagnosis", lambda *given: "nothing", "'skew'"),
    ("12.diagnosis", lambda *given: 0.5, "'skew'"),
    ("12.kept", lambda x, y, px, py: (y[: len(py)] == py).float().mean(), "look each one up"),
    ("12.kept", lambda *given: 1 - kept(*given), "lost their label"),
    ("12.kept", lambda *given: kept(*given) * len(given[3]), "not the number"),
    ("12.kept", lambda *given: 0.5, "expected"),
    ("12.kept", lambda *given: "all", "number"),
]


RIGHT = [
    ("12.decide", right),
    ("12.decide", decide_by(1.96)),
    ("12.own_data", wines),
    ("12.own_data", measured),
    ("12.own_data", lambda: (measured()[0], np.resize(["a", "b"], 200))),
    ("12.episodes_needed", needed),
    ("12.episodes_needed", lambda a, b, m: ceil(4 * (a - b).var(ddof=1) / m**2)),
    ("12.episodes_needed", lambda a, b, m: float(needed(a, b, m))),
    ("12.diagnosis", diagnosis()),
    ("12.diagnosis", diagnosis(1.05, 0.85)),
    ("12.kept", kept),
    ("12.kept", lambda *given: np.float64(kept(*given))),
]
