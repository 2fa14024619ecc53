"""Between and within, against closed forms."""

import math

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn import mixtures
from cotlearn.diagnostics import between_within
from cotlearn.gaussian import LinearGaussian

OTHER = LinearGaussian(A=np.eye(2) / 5, b=[1.0, 2.0], S=3 * np.eye(2), S_c=[[2.0, 0.5], [0.5, 1]])


@pytest.mark.parametrize("problem", [LinearGaussian.example(), OTHER])
def test_linear_gaussian(problem):
    """Var(x1) = S + A S_c A': within and between."""
    x1, c = problem.sample(4000, np.random.default_rng(0))
    found = between_within(torch.from_numpy(x1), torch.from_numpy(c))
    within = np.trace(problem.S)
    between = np.trace(problem.A @ problem.S_c @ problem.A.T)
    assert found.total == pytest.approx(within + between, rel=0.06)
    assert found.within == pytest.approx(within, rel=0.05)
    assert found.between_share == pytest.approx(between / (within + between), abs=0.03)


@pytest.mark.parametrize(
    ("data", "within", "between"),
    [
        (mixtures.petals(), 1.2**2 + 2 * 0.25**2, 16.0),
        (mixtures.eight_gaussians(), 0.2, 25.0),
        (mixtures.moving_modes(), 4 + 2 * 0.25**2, 0.0),
        # |mean|^2 - |E mean|^2 on half a circle of radius 3: 9 (1 - (2 / pi)^2)
        (mixtures.rotating_pair(), 1 + 2 * 0.25**2, 9 * (1 - 4 / math.pi**2)),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_mixtures(data, within, between):
    found = between_within(*data.sample(4000, generator=seeded()))
    assert found.within == pytest.approx(within, rel=0.05)
    assert found.between == pytest.approx(between, rel=0.03, abs=0.05)
    assert found.within + found.between == pytest.approx(found.total)


def test_labels_in_any_order_and_columns_of_any_scale():
    x1, c = mixtures.petals().sample(2000, generator=seeded())
    order = c.argmax(dim=1).argsort()
    assert between_within(x1[order], c[order]).within == pytest.approx(1.565, rel=0.1)
    x1, c = mixtures.rotating_pair().sample(2000, generator=seeded())
    plain = between_within(x1, c)
    assert between_within(x1, 1e4 * c + 3).within == pytest.approx(plain.within, rel=1e-6)


def test_one_condition_and_constant_data():
    x1 = torch.randn(500, 2, generator=seeded())
    constant = between_within(x1, torch.full((500, 1), 0.1))
    assert constant.within == pytest.approx(constant.total, rel=0.1)
    still = between_within(torch.zeros(500, 2), x1)
    assert (still.total, still.between_share) == (0, 0)


def test_integer_conditions():
    x1, c = mixtures.petals().sample(1000, generator=seeded())
    assert between_within(x1, c.long()) == between_within(x1, c)


X = torch.randn(50, 2)


test_bad_input = refused(
    (lambda: between_within(X / 0, X), ValueError, "x1 has NaN"),
    (lambda: between_within(X, X[:4]), ValueError, "c has 4 rows, x1 has 50"),
    (lambda: between_within(X, X[:, 0]), ValueError, "c must have shape"),
    (lambda: between_within(X[:10], X[:10]), ValueError, "x1 needs more than 10 rows, got 10"),
)
