"""Wrong answers to the exercises of notebooks 00 and 03, words of their hints, right ones."""

import math

import torch
from scipy.optimize import linear_sum_assignment
from torch import cdist

from cotlearn.mixtures import petals


def columns(x0, x1):
    return linear_sum_assignment(cdist(x0, x1) ** 2)[1]


def inverse(x0, x1, c):
    order = columns(x0, x1).argsort()
    return x1[order], c[order]


def row_by_row(x0, x1, c):
    nearest = cdist(x0, x1).argmin(dim=1)
    return x1[nearest], c[nearest]


def in_place(x0, x1, c):
    order = columns(x0, x1)
    x1[:], c[:] = x1[order].clone(), c[order].clone()
    return x1, c


def first_petal(c, generator=None):
    return petals().sample_given(torch.eye(4)[:1].expand(len(c), -1), generator=generator)


def augmented(power=2, of_weight=1):
    return lambda a, c, b, d, w: cdist(a, b) ** power + w**of_weight * cdist(c, d) ** power


def one_seed(c, generator=None):
    return petals().sample(len(c), generator=torch.Generator().manual_seed(0))[0]


ALL_RIGHT = {"shape": (256, 6), "gradient": 12, "best_constant": 0, "mean": 2, "euler": 0.25}


def energy(x, y, own=1):
    within = (torch.cdist(z, z).sum() / (len(z) * (len(z) - own)) for z in (x, y))
    return float(2 * torch.cdist(x, y).mean() - sum(within))


MISTAKES = [
    ("00.self_test", {**ALL_RIGHT, "mean": 4}, "mean"),
    ("00.self_test", {**ALL_RIGHT, "shape": (512, 4)}, "shape"),
    ("00.self_test", {**ALL_RIGHT, "euler": ...}, "4 of 5 right; still open: euler"),
    ("00.self_test", {**ALL_RIGHT, "gradient": "twelve"}, "gradient"),
    ("00.self_test", [1, 2], "dict"),
    ("00.self_test", {**ALL_RIGHT, "grad": 12}, "these keys: shape, gradient"),
    ("00.self_test", {**ALL_RIGHT, "grad": 12}, "remove 'grad'"),
    ("00.perfect_one_step", 1.44, "variance"),
    ("00.perfect_one_step", 1.2, "squared"),
    ("00.perfect_one_step", "1.565 or so", "number"),
    ("00.perfect_one_step", 7.0, "squared distance"),
    ("00.perfect_one_step", 1.6, "do not round"),
    ("00.deaf_sampler", lambda c, generator=None: petals().sample_given(c, generator), "listen"),
    ("00.deaf_sampler", lambda c, generator=None: petals().sample(len(c))[0], "seed"),
    ("00.deaf_sampler", lambda c, generator=None: petals().sample(len(c), generator), "tuple"),
    ("00.deaf_sampler", one_seed, "its seed alone"),
    ("00.deaf_sampler", lambda c, generator=None: torch.zeros(len(c), 2), "four petals"),
    ("00.deaf_sampler", first_petal, "four petals"),
    ("00.deaf_sampler", 3, "function"),
    ("03.labels_follow", lambda x0, x1, c: (x1[columns(x0, x1)], c), "labels stayed"),
    ("03.labels_follow", inverse, "inverse"),
    ("03.labels_follow", row_by_row, "smallest total"),
    ("03.labels_follow", in_place, "changed its inputs"),
    ("03.labels_follow", lambda x0, x1, c: x1, "two tensors"),
    ("03.labels_follow", lambda x0, x1, c: (x1[:3], c), "shape"),
    ("03.augmented_cost", augmented(power=1), "square the distances"),
    ("03.augmented_cost", augmented(of_weight=2), "itself is not squared"),
    ("03.augmented_cost", lambda *given: augmented()(*given).T, "rows belong"),
    ("03.augmented_cost", lambda *given: torch.zeros(5), "shape"),
    ("03.skew", lambda r, v: float(r @ r) / v, "covariance"),
    ("03.skew", lambda r, v: (math.sqrt(1 - float(r @ r) / v) - 1) ** 2, "mean"),
    ("03.skew", lambda r, v: 2 - 2 * math.sqrt(1 - min(float(r @ r), 1.0)), "divide"),
    ("03.skew", lambda r, v: r, "one number"),
    ("03.energy_distance", lambda x, y: energy(x, y, own=0), "no pair"),
    ("03.energy_distance", lambda x, y: -energy(x, y), "sign"),
    ("03.energy_distance", lambda x, y: max(0.0, energy(x, y)), "do not cut it off"),
    ("03.energy_distance", lambda x, y: energy(x**2, y**2), "expected"),
]


RIGHT = [
    ("03.energy_distance", energy),
    ("00.self_test", ALL_RIGHT),
    *(("00.perfect_one_step", value) for value in (1.565, 1.57, 1.56, torch.tensor(1.565))),
]
