"""Wrong answers to the exercises of notebook 10, words of their hints, right ones."""

import operator

import numpy as np
import torch

from cotlearn.metrics import mode_entropy


def entropy(ways):
    counts = np.unique(ways, return_counts=True)[1]
    share = counts / counts.sum()
    return -(share * np.log(share)).sum() if len(ways) else 0.0


def by_share(modes):
    with np.errstate(all="ignore"):
        share = np.stack([(modes == way).mean(axis=1) for way in range(3)])
        return -(share * np.log(share)).sum(axis=0).mean()


def error(model, x0, c, x1):
    return (model(x0, c) - x1).square().sum(dim=1).mean()


def gap(model, x0, c, x1, order):
    return error(model, x0[order], c, x1) - error(model, x0, c, x1)


def pareto(policies, strictly=False):
    found, above = [], operator.gt if strictly else operator.ge
    for name, own in policies.items():
        others = [other for other in policies.values() if other != own]
        beaten = any(above(o[0], own[0]) and above(o[1], own[1]) for o in others)
        found += [] if beaten else [name]
    return found


MISTAKES = [
    ("10.ways_entropy", lambda m: -mode_entropy(m), "minus sign"),
    ("10.ways_entropy", lambda m: mode_entropy(m) / np.log(2), "np.log2"),
    ("10.ways_entropy", lambda m: np.exp(mode_entropy(m)), "perplexity"),
    ("10.ways_entropy", lambda m: mode_entropy(m) / np.log(3), "not normalised"),
    ("10.ways_entropy", lambda m: np.mean([entropy(row) for row in m]), "-1 is a failure"),
    ("10.ways_entropy", lambda m: entropy(m[m >= 0]), "start by start"),
    ("10.ways_entropy", lambda m: mode_entropy(m[(m >= 0).any(1)]), "counts, with entropy 0"),
    ("10.ways_entropy", lambda m: mode_entropy(m) * len(m), "not the sum"),
    ("10.ways_entropy", by_share, "0 log 0"),
    ("10.ways_entropy", lambda m: 0.5, "expected"),
    ("10.ways_entropy", lambda m: m, "one number"),
    ("10.ways_entropy", 1.0, "expected a function"),
    ("10.gap", lambda *given: -gap(*given), "fresh minus coupled"),
    ("10.gap", lambda m, a, c, b, o: error(m, a[o], c[o], b) - error(m, a, c, b), "stay with"),
    ("10.gap", lambda m, a, c, b, o: error(m, a, c[o], b) - error(m, a, c, b), "not the cond"),
    ("10.gap", lambda m, x0, c, x1, o: gap(m, x0, c, x1, torch.arange(len(o))), "nothing changes"),
    ("10.gap", lambda m, x0, c, x1, o: gap(m, torch.randn(x0.shape), c, x1, o), "expected"),
    ("10.gap", lambda *given: gap(*given) / 3, "not a mean"),
    ("10.gap", lambda *given: gap(*given) * len(given[1]), "not the sum"),
    ("10.gap", lambda m, x0, c, x1, o: error(m, x0[o], c, x1), "expected"),
    ("10.gap", lambda *given: torch.zeros(3), "one number"),
    ("10.pareto", lambda ps: sorted(set(ps) - set(pareto(ps))), "the beaten ones"),
    ("10.pareto", lambda ps: pareto(ps, strictly=True), "is enough to beat"),
    ("10.pareto", lambda ps: [max(ps, key=lambda k: sum(ps[k]))], "not their product"),
    ("10.pareto", lambda ps: [max(ps, key=ps.get)], "not success alone"),
    ("10.pareto", lambda ps: list(ps), "expected"),
    ("10.pareto", lambda ps: 3, "in a list"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][0] > f * s[k][1]], "new / known"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] - s[k][0] > f], "not the difference"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] > s[k][0]], "use the factor"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] > f], "its own score"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] >= f * s[k][0]], "exactly as much"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] > 2 * s[k][0]], "use it as it is"),
    ("10.memorises", lambda s, f: [k for k in s if s[k][1] > (1 + f) * s[k][0]], "as it is"),
    ("10.memorises", lambda s, f: "a", "in a list"),
]

RIGHT = [
    ("10.ways_entropy", mode_entropy),
    ("10.gap", gap),
    ("10.gap", lambda *given: float(gap(*given))),
    ("10.pareto", pareto),
    ("10.pareto", lambda ps: tuple(reversed(pareto(ps)))),
    ("10.memorises", lambda s, f: [k for k, (known, new) in s.items() if new / known > f]),
]
