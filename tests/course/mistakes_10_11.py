"""Wrong answers to the exercises of notebooks 10 and 11, words of their hints, right ones."""

import operator

import numpy as np
import torch

from cotlearn.flows.networks import SpatialSoftmax
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


def cross_fit(episode, fit, *, alone=False):
    found = torch.zeros_like(fit(episode >= 0))
    for fold in range(5):
        left = episode % 5 == fold
        found[left] = fit(left if alone else ~left)[left]
    return found


MISTAKES = [
    ("10.cross_fit", lambda episode, fit: fit(episode >= 0), "saw the window's own episode"),
    ("10.cross_fit", lambda *given: cross_fit(*given, alone=True), "on the fold alone"),
    ("10.cross_fit", lambda e, fit: cross_fit(torch.arange(len(e)), fit), "folds are of windows"),
    ("10.cross_fit", lambda e, f: sum(f(e % 5 != k) for k in range(5)) / 5, "not the mean of five"),
    ("10.cross_fit", lambda episode, fit: episode, "shape"),
    ("10.cross_fit", 5, "expected a function"),
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
    ("10.cross_fit", cross_fit),
    ("10.cross_fit", lambda e, fit: torch.stack([fit(e % 5 != k % 5)[i] for i, k in enumerate(e)])),
    ("10.ways_entropy", mode_entropy),
    ("10.gap", gap),
    ("10.gap", lambda *given: float(gap(*given))),
    ("10.pareto", pareto),
    ("10.pareto", lambda ps: tuple(reversed(pareto(ps)))),
    ("10.memorises", lambda s, f: [k for k, (known, new) in s.items() if new / known > f]),
]


def mean_place(share):
    right, down = torch.linspace(-1, 1, share.shape[2]), torch.linspace(-1, 1, share.shape[1])
    return torch.stack([share.sum(dim=1) @ right, share.sum(dim=2) @ down], dim=1)


def place(h):
    return mean_place(h.flatten(1).softmax(dim=1).view_as(h))


def strongest(h):
    return mean_place((h == h.amax(dim=(1, 2), keepdim=True)).float())


def in_cells(h):
    sides = torch.tensor([h.shape[2], h.shape[1]])
    return (place(h) + 1) / 2 * (sides - 1)


def components(pixels, mean, basis):
    return (pixels - mean) @ basis.T


def inside(label, value):
    off = [value[label == k] - value[label == k].mean(dim=0) for k in label.unique()]
    return torch.cat(off).square().sum(dim=1).mean()


def by_position(label, value):
    mean = torch.stack([value[label == k].mean(dim=0) for k in label.unique()])
    return (value - mean[label]).square().sum(dim=1).mean()


def whole(label, value):
    return (value - value.mean(dim=0)).square().sum(dim=1).mean()


def uncentred(x0, m):
    size = x0.shape[1] * m.square().sum(dim=1).mean()
    return (x0 * m).sum(dim=1).mean() / size.sqrt()


def correlation(x0, m):
    return uncentred(x0, m - m.mean(dim=0))


MISTAKES += [
    ("11.place", lambda h: place(h).flip(1), "changed places"),
    ("11.place", strongest, "not the mean places"),
    ("11.place", mean_place, "not shares yet"),
    ("11.place", lambda h: mean_place(h.flatten().softmax(0).view_as(h)), "over its cells only"),
    ("11.place", in_cells, "from -1"),
    ("11.place", lambda h: place(h).T, "must have shape (5, 2)"),
    ("11.place", lambda h: -place(h), "not the mean places"),
    ("11.place", 3, "expected a function"),
    ("11.components", lambda p, m, b: (p - p.mean(dim=0)) @ b.T, "slip of the published code"),
    ("11.components", lambda p, m, b: p @ b.T, "subtract the fitted mean first"),
    ("11.components", lambda p, m, b: (p + m) @ b.T, "not added"),
    ("11.components", lambda p, m, b: (m - p) @ b.T, "not mean minus pixels"),
    ("11.components", lambda p, m, b: p - m, "must have shape (6, 3)"),
    ("11.components", lambda p, m, b: 2 * components(p, m, b), "expected [["),
    ("11.components", lambda p, m, b: (p - m) @ b, "raised RuntimeError"),
    ("11.inside", whole, "own cluster"),
    ("11.inside", lambda k, v: len(v) * inside(k, v), "not the total"),
    ("11.inside", lambda k, v: inside(k, v) / 2, "the sum over coordinates"),
    ("11.inside", lambda k, v: whole(k, v) - inside(k, v), "expected"),
    ("11.inside", by_position, "raised IndexError"),
    ("11.correlation", lambda x0, m: correlation(x0, m) * (x0.shape[1] / 3) ** 0.5, "expected"),
    ("11.correlation", uncentred, "the average of m"),
    ("11.correlation", lambda x0, m: 3**0.5 * correlation(x0, m), "d is missing"),
    ("11.correlation", lambda x0, m: correlation(x0, m) / 3, "a sum over columns"),
    ("11.correlation", lambda x0, m: correlation(x0, m).square(), "expected"),
    ("11.correlation", lambda x0, m: x0, "return one number"),
]


RIGHT += [
    ("11.place", place),
    ("11.place", lambda h: SpatialSoftmax()(h[:, None])),
    ("11.components", components),
    ("11.components", lambda p, m, b: torch.einsum("np,kp->nk", p - m, b)),
    ("11.inside", inside),
    ("11.correlation", correlation),
]
