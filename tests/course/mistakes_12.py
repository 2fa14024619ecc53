"""Wrong answers to the exercises of notebook 12, words of their hints, right ones."""

import numpy as np
import torch


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


def megabytes(n, k):
    return 4 * (n / k) ** 2 / 1e6


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
    ("12.regret", lambda c, s: s[c] / min(s.values()) - 1, "times 100"),
    ("12.regret", lambda c, s: 100 * (s[c] - min(s.values())) / s[c], "of the best score"),
    ("12.regret", lambda c, s: 100 * (s[c] / max(s.values()) - 1), "small scores are good"),
    ("12.regret", lambda c, s: 100 * (s[c] - min(s.values())), "divide it"),
    ("12.regret", lambda c, s: 100 * s[c] / min(s.values()), "subtract the best"),
    ("12.regret", lambda c, s: s.pop(c) and 0, "changed its inputs"),
    ("12.regret", lambda c, s: 7.0, "more than the smallest"),
    ("12.kept", lambda x, y, px, py: (y[: len(py)] == py).float().mean(), "look each one up"),
    ("12.kept", lambda *given: 1 - kept(*given), "lost their label"),
    ("12.kept", lambda *given: kept(*given) * len(given[3]), "not the number"),
    ("12.kept", lambda *given: 0.5, "expected"),
    ("12.kept", lambda *given: "all", "number"),
    ("12.megabytes", lambda n, k: 4 * n**2 / k / 1e6, "one matrix at a time"),
    ("12.megabytes", lambda n, k: 4 * n**2 / 1e6, "a stratum has n / k rows"),
    ("12.megabytes", lambda n, k: (n / k) ** 2 / 1e6, "four bytes"),
    ("12.megabytes", lambda n, k: 4 * (n / k) ** 2, "10^6 bytes"),
    ("12.megabytes", lambda n, k: 4 * (n / k) ** 2 / 2**20, "not 2^20"),
    ("12.megabytes", lambda n, k: 4 * (n / k) / 1e6, "columns"),
    ("12.megabytes", lambda n, k: 3.0, "expected"),
]


RIGHT = [
    ("12.decide", right),
    ("12.decide", decide_by(1.96)),
    ("12.regret", lambda c, s: 100 * (s[c] / min(s.values()) - 1)),
    ("12.kept", kept),
    ("12.kept", lambda *given: np.float64(kept(*given))),
    ("12.megabytes", megabytes),
]
