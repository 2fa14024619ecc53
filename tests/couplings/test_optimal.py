import math

import numpy as np
import ot
import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import Independent, MinibatchOT


def batch(n=64, d=2, seed=0):
    g = seeded(seed)
    return torch.randn(n, d, generator=g), 3 + torch.randn(n, d, generator=g)


def cost(pairs):
    return float((pairs.x0 - pairs.x1).square().sum(dim=1).mean())


@pytest.mark.parametrize("d", [1, 2, 5])
@pytest.mark.parametrize("n", [1, 16, 99, 150])
def test_cost_is_that_of_pot(n, d):
    x0, x1 = batch(n, d)
    weights = np.full(n, 1 / n)
    expected = ot.emd2(weights, weights, ot.dist(x0.double().numpy(), x1.double().numpy()))
    assert cost(MinibatchOT()(x0, x1)) == pytest.approx(expected, rel=1e-5)


def test_it_never_looks_at_the_condition():
    x0, x1 = batch()
    first = MinibatchOT()(x0, x1, torch.zeros(64, 1))
    second = MinibatchOT()(x0, x1, torch.randn(64, 4))
    assert torch.equal(first.target_index, second.target_index)
    assert MinibatchOT()(x0, x1).c is None
    assert MinibatchOT.name == "minibatch_ot"


def test_the_condition_of_x1_goes_along():
    x0, x1 = batch()
    c = torch.arange(64.0)[:, None]
    for sampling in ("permutation", "replacement"):
        pairs = MinibatchOT(sampling=sampling)(x0, x1, c, generator=seeded())
        assert torch.equal(pairs.c[:, 0].long(), pairs.target_index)


@pytest.mark.parametrize("plan", ["exact", "sinkhorn"])
def test_with_replacement_a_share_of_one_over_e_is_lost(plan):
    lost = []
    for seed in range(10):
        x0, x1 = batch(200, seed=seed)
        coupling = MinibatchOT(plan=plan, sampling="replacement")
        pairs = coupling(x0, x1, generator=seeded(seed))
        lost.append(1 - len(pairs.target_index.unique()) / 200)
    assert np.mean(lost) == pytest.approx(math.exp(-1), abs=0.03)


def test_replacement_draws_from_the_exact_plan():
    x0, x1 = batch()
    best = MinibatchOT()(x0, x1).target_index
    pairs = MinibatchOT(sampling="replacement")(x0, x1, generator=seeded())
    assert torch.equal(pairs.target_index, best[pairs.source_index])


@pytest.mark.slow
def test_sinkhorn_costs_more_than_exact_and_less_than_independent():
    x0, x1 = batch(150)
    exact, independent = cost(MinibatchOT()(x0, x1)), cost(Independent()(x0, x1))
    for sampling in ("permutation", "replacement"):
        coupling = MinibatchOT(plan="sinkhorn", sampling=sampling, regularization=0.05)
        entropic = np.mean([cost(coupling(x0, x1, generator=seeded(s))) for s in range(20)])
        assert entropic > 0.9 * exact
        assert entropic < 0.5 * (exact + independent)


def test_sinkhorn_permutation_is_exact_for_small_regularization():
    x0, x1 = batch(30)
    entropic = MinibatchOT(plan="sinkhorn", regularization=0.003)(x0, x1)
    assert cost(entropic) == pytest.approx(cost(MinibatchOT()(x0, x1)), rel=0.02)


OT = MinibatchOT
test_bad_options = refused(
    (lambda: OT(plan="emd"), ValueError, "plan must be one of exact, sinkhorn; got 'emd'"),
    (lambda: OT(sampling="both"), ValueError, "sampling must be one of permutation, replacement"),
    (lambda: OT(regularization=0), ValueError, "regularization must be above 0"),
    (lambda: OT(regularization=-0.1), ValueError, "regularization must be at least 0"),
    (lambda: OT(regularization=math.nan), ValueError, "regularization must be at least 0"),
    (lambda: OT(regularization="small"), TypeError, "regularization must be a number"),
)
