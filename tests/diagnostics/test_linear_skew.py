"""Linear skew: its level, its power in many dimensions, and what it is blind to."""

import numpy as np
import pytest
import torch
from support import joined, refused, seeded, take

from cotlearn.couplings import MinibatchOT, StratifiedOT, centred
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import linear_skew, prior_skew
from cotlearn.mixtures import moving_modes


def normal(n, d, seed=0):
    return torch.randn(n, d, generator=seeded(seed))


def paired(coupling, data, *, rows):
    pairs = take(coupling, data, rows // 256, 256, generator=seeded())
    return joined(pairs, "x0"), joined(pairs, "c")


def following(n=10_000, d=20, k=8, noise=0.5, seed=0):
    """Data in many dimensions that follow a condition in many dimensions."""
    c = normal(n, k, seed)
    return Dataset(c @ normal(k, d, 1) + noise * normal(n, d, seed + 1), c)


SHAPES = [(500, 2, 1), (1000, 16, 8), (600, 1, 3)]
POLYNOMIALS = [({"degree": degree}, shape) for degree in (1, 2) for shape in SHAPES]


@pytest.mark.slow
@pytest.mark.parametrize(("features", "shape"), [*POLYNOMIALS, ({"cells": 4}, SHAPES[0])], ids=str)
def test_its_level_is_the_one_it_says(features, shape):
    n, d, k = shape
    found = [
        linear_skew(normal(n, d, seed), normal(n, k, 1000 + seed).abs(), **features)
        for seed in range(200)
    ]
    p_values = np.array([one.p_value for one in found])
    assert 0.35 < np.mean(p_values < 0.5) < 0.65
    assert sum(one.flagged for one in found) <= 9  # 2 expected; more than 9 once in 20,000 times
    assert abs(np.mean([one.explained for one in found])) < 0.003


def test_explained_is_the_share_of_a_regression():
    c, rest = normal(50_000, 3), normal(50_000, 2, 1)
    x0 = torch.stack([0.6 * c[:, 0] + 0.8 * rest[:, 0], rest[:, 1]], dim=1)
    found = linear_skew(x0, c)
    assert found.flagged
    assert found.explained == pytest.approx(0.36 / 2, abs=0.01)  # of two columns, one follows c
    assert linear_skew(c, c).explained == pytest.approx(1)


def test_units_and_repeated_columns_do_not_matter():
    x0, c = paired(MinibatchOT(), following(), rows=4096)
    same = linear_skew(x0, torch.cat([1e4 * c, c, torch.ones(len(c), 1)], dim=1) + 3)
    assert same.explained == pytest.approx(linear_skew(x0, c).explained, rel=1e-4)


@pytest.mark.slow
def test_in_many_dimensions_it_sees_what_neighbours_do_not():
    x0, c = paired(StratifiedOT(256), following(d=40, k=12, noise=8), rows=8192)
    assert linear_skew(x0, c).p_value < 1e-6
    assert not prior_skew(x0, c, generator=seeded()).flagged


@pytest.mark.slow
def test_finer_strata_leave_less_of_it():
    shares = [
        linear_skew(*paired(coupling, following(), rows=8192)).explained
        for coupling in (MinibatchOT(), StratifiedOT(16), StratifiedOT(256))
    ]
    assert shares[0] > shares[1] > 2 * shares[2] > 0


def test_only_cells_see_what_a_polynomial_has_not_subtracted():
    """Centred by a quadratic, naive OT passes the quadratic test and follows c all the same."""
    c = 4 * torch.rand(8192, 1, generator=seeded()) - 2
    x1 = torch.cat([(3 * c).sin(), (3 * c).cos()], dim=1) + 0.1 * normal(8192, 2)
    weights = torch.linalg.lstsq(c ** torch.arange(3), x1).solution
    coupling = centred(MinibatchOT(), lambda c: c ** torch.arange(3) @ weights)
    x0, c = paired(coupling, Dataset(x1, c), rows=8192)
    assert linear_skew(x0, c, degree=2).explained < 0.01
    assert linear_skew(x0, c, cells=32).explained > 0.3


def test_cells_of_classes_are_the_classes():
    label = torch.randint(0, 4, (2000,), generator=seeded())
    x0 = normal(2000, 2) + label[:, None]
    classes = torch.nn.functional.one_hot(label, 4).float()
    by_columns, by_cells = linear_skew(x0, classes), linear_skew(x0, classes, cells=64)
    assert by_cells.explained == pytest.approx(by_columns.explained, rel=1e-6)


def test_it_is_blind_where_only_the_shape_of_the_noise_depends_on_the_condition():
    x0, c = paired(MinibatchOT(), moving_modes(), rows=2048)
    assert not linear_skew(x0, c).flagged
    assert prior_skew(x0, c, generator=seeded()).flagged


def test_degree_two_sees_a_mean_that_bends():
    c = normal(5000, 2)
    x0 = 0.3 * (c.square() - 1) + normal(5000, 2, 1)
    assert not linear_skew(x0, c).flagged
    assert linear_skew(x0, c, degree=2).flagged


def test_a_constant_condition_explains_nothing():
    found = linear_skew(normal(100, 2), torch.ones(100, 1))
    assert (found.explained, found.p_value, found.flagged) == (0, 1, False)


X0, C = normal(40, 4), normal(40, 9)
test_bad_input = refused(
    ({}, "at least 45 rows for 4 columns of noise and 9 features"),
    ({"degree": 3}, "degree must be at most 2, got 3"),
    ({"cells": 1}, "cells must be"),
    ({"cells": 20}, r"at least 95 rows for 4 columns .* 19 features"),
    ({"c": C[:39]}, "c has 39 rows"),
    ({"x0": X0 * float("nan")}, "x0"),
    error=ValueError,
    of=lambda **options: linear_skew(**({"x0": X0, "c": C} | options)),
)


def test_in_many_columns_of_c_it_sees_what_near_neighbours_miss():
    """A fifth of the variance of two columns of noise is linear in c."""
    seen = {}
    for k in (2, 12):
        flags = []
        for seed in range(10):
            c, e = normal(500, k, seed), normal(500, 2, 100 + seed)
            x0 = 0.8**0.5 * e + 0.2**0.5 * c[:, [0, -1]]
            near = prior_skew(x0, c, generator=seeded(seed))
            flags.append((near.flagged, linear_skew(x0, c).flagged))
        seen[k] = np.sum(flags, axis=0)
    assert seen[2][1] == seen[12][1] == 10
    assert seen[12][0] <= 5  # 2 expected
    assert seen[2][0] >= seen[12][0]


def test_a_few_sentinels_hide_no_skew():
    """With 3 % of the values at -9999 it called noise clean that c explains to nine tenths."""
    x0, lost = torch.randn(4096, 2, generator=seeded()), torch.rand(4096, 2, generator=seeded(1))
    c = torch.where(lost < 0.03, -9999.0, x0 + 0.3 * torch.randn(4096, 2, generator=seeded(2)))
    assert linear_skew(x0, c).flagged
    assert linear_skew(x0, c).explained > 0.02
