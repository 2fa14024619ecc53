"""The kernel of the exact solver holds no denormal numbers, which some processors multiply slowly.

A timed test cannot see it on the others, so entries are counted.
"""

import numpy as np
import pytest

from cotlearn.couplings import annealing
from cotlearn.couplings.annealing import LEAST, STAGES, TEMPERATURE

TINY = np.finfo(np.float32).tiny  #: the least normal number


def slow(products):
    """How many of these single-precision numbers are denormal."""
    return int(((products != 0) & (np.abs(products) < TINY)).sum())


@pytest.mark.parametrize("dim", [2, 16, 64])
@pytest.mark.parametrize("far", [0, 30])
@pytest.mark.parametrize("n", [65, 256, 512])
def test_no_entry_and_no_product_with_a_scaling_is_denormal(n, dim, far):
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(2, n, dim))
    y[: n // 2] += far
    cost = ((x[:, None] - y[None]) ** 2).sum(2)
    least, spread, _, _ = annealing.survey(cost)
    kernel, sums = np.empty((n, n), np.float32), np.empty(n, np.float32)
    annealing._start(kernel, cost, least, -1 / (TEMPERATURE * spread))
    for _ in range(STAGES[1]):
        u, v = np.ones(n, np.float32), np.ones(n, np.float32)
        for _ in range(5):
            assert slow(kernel) == 0
            assert slow(kernel * LEAST) == 0  # the least scaling
            assert slow(kernel * v) == slow(kernel * u[:, None]) == 0
            annealing._step(kernel, u, v, sums)
        annealing._cool(kernel, u, v)
    assert 0 < (kernel > 0).mean() < 1


def test_without_the_floors_there_would_be_some():
    """So the counts above can fail."""
    x, y = np.random.default_rng(0).normal(size=(2, 256, 16))
    cost = ((x[:, None] - y[None]) ** 2).sum(2).astype(np.float32)
    kernel = np.exp(-(cost - cost.min(axis=0)) / (TEMPERATURE * cost.std()))
    assert slow(kernel**5) + slow(kernel**25) > 1000
