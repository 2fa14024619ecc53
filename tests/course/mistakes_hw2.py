"""Typical wrong answers to homework 2, and words of the hint that each must get."""

import math
from operator import itemgetter

import torch
from scipy.optimize import linear_sum_assignment

from cotlearn.metrics import squared_w2


def far(a, b):
    return torch.cdist(a, b)


def shuffled(c, g=None):
    return c[torch.randperm(len(c), generator=g)]


def paired(x0, x1, c0, c, weight, *, labels=None):
    rows, columns = linear_sum_assignment(far(x0, x1) ** 2 + weight * far(c0, c) ** 2)
    return x0[rows], x1[columns], (c if labels is None else labels)[columns]


def drawn(c, g):
    return c[torch.randint(len(c), (len(c),), generator=g)]


def labels_stay(x0, x1, c, weight, g):
    return *paired(x0, x1, shuffled(c, g), c, weight)[:2], c


def labels_of_the_noise(x0, x1, c, weight, g):
    c0 = shuffled(c, g)
    return paired(x0, x1, c0, c, weight, labels=c0)


def with_replacement(x0, x1, c, weight, g):
    pairs = paired(x0, x1, shuffled(c, g), c, weight)
    drawn = torch.randint(len(c), (len(c),), generator=g)
    return tuple(part[drawn] for part in pairs)


def nearest(x0, x1, c, weight, g):
    chosen = (far(x0, x1) ** 2 + weight * far(shuffled(c, g), c) ** 2).argmin(1)
    return x0, x1[chosen], c[chosen]


def random_inside_classes(x0, x1, c, weight, g):
    cost = weight * far(shuffled(c, g), c) ** 2 + torch.rand(len(c), len(c), generator=g)
    rows, columns = linear_sum_assignment(cost)
    return x0[rows], x1[columns], c[columns]


def each(made, real, c):
    label = c.argmax(1)
    return [squared_w2(made[label == k], real[label == k]) for k in label.unique()]


def by_frequency(a, b, c):
    return sum(w * v for w, v in zip(c.mean(0).tolist(), each(a, b, c), strict=True))


def rows_of(weights, skew, variance):
    return list(zip(weights, skew, variance, strict=True))


def fitting(weights, skew, variance, budget):
    return [row for row in rows_of(weights, skew, variance) if row[1] <= budget]


def no_way_out(weights, skew, variance, budget):
    fits = fitting(weights, skew, variance, budget)
    return min(fits, key=lambda row: row[2])[0] if fits else max(weights)


def below_the_budget(weights, skew, variance, budget):
    fits = [row for row in rows_of(weights, skew, variance) if row[1] < budget]
    if fits:
        return min(fits, key=lambda row: row[2])[0]
    return min(rows_of(weights, skew, variance), key=lambda row: row[1])[0]


def place_instead(weights, skew, variance, budget):
    fits = fitting(weights, skew, variance, budget)
    chosen = min(fits or rows_of(weights, skew, variance), key=lambda row: row[2])
    return weights.index(chosen[0])


MISTAKES = [
    ("hw2.cost", lambda a, b, c, d, w: far(a, b) + w * far(c, d), "square the distances"),
    ("hw2.cost", lambda a, b, c, d, w: far(a, b) ** 2 + w * far(c, d), "of the conditions, too"),
    ("hw2.cost", lambda a, b, c, d, w: far(a, b) ** 2, "do not count yet"),
    (
        "hw2.cost",
        lambda a, b, c, d, w: far(a, b) ** 2 + (w * far(c, d)) ** 2,
        "itself is not squared",
    ),
    ("hw2.cost", lambda a, b, c, d, w: w * far(a, b) ** 2 + far(c, d) ** 2, "belongs to the"),
    ("hw2.cost", lambda a, b, c, d, w: far(b, a) ** 2 + w * far(d, c) ** 2, "shape (4, 6)"),
    ("hw2.cost", lambda a, b, c, d, w: far(a, b) ** 2 + w * far(c, d).T ** 2, "raised Runtime"),
    ("hw2.pair", labels_stay, "labels stayed behind"),
    ("hw2.pair", labels_of_the_noise, "keep its own condition"),
    ("hw2.pair", lambda a, b, c, w, g: paired(a, b, c, c, w), "random permutation"),
    ("hw2.pair", lambda a, b, c, w, g: paired(a, b, shuffled(c), c, w), "generator=generator"),
    ("hw2.pair", with_replacement, "with replacement"),
    ("hw2.pair", nearest, "rows were never used"),
    ("hw2.pair", random_inside_classes, "inside each class"),
    ("hw2.pair", lambda a, b, c, w, g: paired(a, b, shuffled(c, g), c, 50.0), "plain OT"),
    ("hw2.pair", lambda a, b, c, w, g: paired(a, b, shuffled(c, g), c, 0.0), "changes nothing"),
    ("hw2.pair", lambda x0, x1, c, w, g: (x0, x1), "three things"),
    ("hw2.pair", lambda x0, x1, c, w, g: (x0, x1, c), "as they went in"),
    ("hw2.pair", lambda a, b, c, w, g: paired(a, b, drawn(c, g), c, w), "each row of c once"),
    ("hw2.conditional_w2", lambda a, b, c: squared_w2(a, b), "do not count yet"),
    ("hw2.conditional_w2", lambda *a: sum(each(*a)), "do not sum"),
    ("hw2.conditional_w2", lambda *a: math.sqrt(sum(each(*a)) / 3), "no root"),
    ("hw2.conditional_w2", lambda *a: sum(map(math.sqrt, each(*a))) / 3, "before the mean"),
    ("hw2.conditional_w2", lambda *a: max(each(*a)), "the worst of them"),
    ("hw2.conditional_w2", by_frequency, "counts alike"),
    ("hw2.choose_weight", lambda w, s, v, budget: w[v.index(min(v))], "above the budget"),
    ("hw2.choose_weight", lambda w, s, v, budget: w[s.index(min(s))], "costs variance"),
    ("hw2.choose_weight", lambda w, s, v, budget: max(w), "costs variance"),
    ("hw2.choose_weight", lambda *a: min(fitting(*a) or rows_of(*a[:3]))[0], "need not have"),
    ("hw2.choose_weight", below_the_budget, "equals the budget"),
    ("hw2.choose_weight", place_instead, "not its place"),
    ("hw2.choose_weight", no_way_out, "smallest skew"),
    ("hw2.choose_weight", lambda *a: min(fitting(*a), key=itemgetter(2))[0], "no skew fits"),
]
