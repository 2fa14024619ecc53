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


def test_the_first_kernel_is_an_exponential():
    cost = np.random.default_rng(0).uniform(0, 60, (70, 70))
    cost[:, 0] = 1e30
    least = cost.min(axis=0)
    kernel = np.empty((70, 70), np.float32)
    annealing._start(kernel, cost, least, -1.0)
    exact = np.exp(least - cost)
    assert np.allclose(kernel, exact, rtol=0.05, atol=1e-10)
    assert (kernel[:, 0] == 1).all()  # all of this column are equal
    near = exact > np.exp(-8)
    assert abs(kernel[near] / exact[near] - 1).max() < 2e-3
    assert (kernel[exact < 1e-26] == 0).all()


@pytest.mark.parametrize("rows", [65, 256, 400])
def test_labels_leave_few_rows_to_the_search(rows):
    """Where a condition splits a batch, the last temperature is that of a class, not of all."""
    rng = np.random.default_rng(rows)
    label, (x0, x1) = rng.integers(4, size=rows), rng.normal(size=(2, rows, 2))
    apart = label[rng.permutation(rows)][:, None] != label
    cost = ((x0[:, None] - x1) ** 2).sum(2) + 300.0 * apart
    least, spread, near, _ = annealing.survey(cost)
    u, v = annealing.potentials(cost, least, spread, near)
    taken = np.unique((cost - u[:, None] - v).argmin(axis=1))
    assert len(taken) > 0.7 * rows
