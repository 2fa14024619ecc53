"""Deployment gap and error budget, against the exactly solvable case."""

from functools import partial

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn import mixtures
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.datasets import Dataset, unconditional
from cotlearn.diagnostics import deployment_gap, error_budget
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.gaussian import LinearGaussian
from cotlearn.metrics import conditional_squared_w2

PROBLEM = LinearGaussian.example()
BOTH_SIDES = torch.tensor([[-1.0], [1.0]])  # E c = 0, E c^2 = 1: exact for a quadratic in c


class Gaussian:
    """`LinearGaussian` as data of the library."""

    def sample(self, n, generator=None):
        c = torch.randn(n, 1, generator=generator)
        return self.sample_given(c, generator), c

    def sample_given(self, c, generator=None):
        noise = torch.randn(len(c), 2, generator=generator, dtype=torch.float64)
        root = torch.from_numpy(np.linalg.cholesky(PROBLEM.S))
        return (c.double() @ torch.from_numpy(PROBLEM.A).T + noise @ root.T).float()

    def conditions(self, n=9):
        return BOTH_SIDES


class Exact:
    """The field that an infinite network learns from a coupling with infinite batches."""

    dim = 2

    def __init__(self, g):
        self.flow = PROBLEM.flow(g)

    def __call__(self, t, x, c):
        return torch.from_numpy(self.flow.velocity(float(t), x.double(), c.double())).float()


def test_no_gap_where_noise_does_not_know_the_condition():
    gap = deployment_gap(Exact("independent"), Gaussian(), Independent(), nfe=4, n=256)
    assert gap.gap == pytest.approx(gap.fresh - gap.coupled)
    assert gap.gap_interval[0] < 0 < gap.gap_interval[1]
    assert abs(gap.gap) < 0.15 * gap.fresh


def test_the_gap_of_naive_ot_is_its_closed_form_error():
    """On the noise of training it is nearly perfect; fresh noise pays the floor of 3.48."""
    gap = deployment_gap(Exact(0.0), Gaussian(), MinibatchOT(), nfe=1, n=512, repetitions=4)
    assert gap.gap_interval[0] > 0
    assert gap.coupled < 0.2 * gap.fresh  # what is left is the sampling floor
    assert gap.gap == pytest.approx(PROBLEM.flow(0.0).squared_w2(1), rel=0.1)


def test_a_heavy_condition_closes_it():
    gap = deployment_gap(Exact(30.0), Gaussian(), ConditionalOT(100.0), nfe=1, n=256)
    assert abs(gap.gap) < 0.1


@pytest.mark.slow
def test_a_trained_network():
    data, network = mixtures.petals(), VelocityMLP(2, 4, width=32, depth=2, seed=0)
    options = {"steps": 150, "batch_size": 128, "learning_rate": 1e-2, "ema": 0.9}
    gaps = []
    for coupling in (Independent(), MinibatchOT()):
        trained = fit(network, data, coupling, **options, progress=False).network
        gaps.append(deployment_gap(trained, data, coupling, n=128, repetitions=4))
    assert gaps[1].gap_interval[0] > max(0, gaps[0].gap_interval[1])


def test_the_same_seed_gives_the_same_gap():
    call = partial(deployment_gap, Exact(0.0), Gaussian(), MinibatchOT(), n=100, repetitions=2)
    assert call(seed=3) == call(seed=3)
    assert call(seed=3) != call(seed=4)


def test_constant_conditions_have_no_weight():
    class Constant(Gaussian):
        def sample(self, n, generator=None):
            x1, _ = super().sample(n, generator)
            return x1, torch.zeros(n, 1)

    gap = deployment_gap(Exact("independent"), Constant(), Independent(), n=100, repetitions=2)
    assert np.isfinite([gap.coupled, gap.fresh, *gap.gap_interval]).all()


def test_the_budget_of_naive_ot_is_all_coupling():
    naive = Exact(0.0)
    budget = error_budget(naive, Gaussian(), naive, nfe=2, n=800)
    assert budget.network == 0
    assert budget.discretisation == pytest.approx(0, abs=0.05)  # straight paths
    assert budget.coupling == pytest.approx(PROBLEM.flow(0.0).squared_w2(), rel=0.1)
    assert 0 < budget.floor < 0.1


@pytest.mark.slow
def test_the_budget_of_independent_pairs_is_all_discretisation():
    exact, flow = Exact("independent"), PROBLEM.flow("independent")
    budget = error_budget(exact, Gaussian(), exact, nfe=1, n=800)
    assert budget.network == 0
    assert budget.coupling == pytest.approx(0, abs=0.05)
    assert budget.discretisation == pytest.approx(flow.squared_w2(1), rel=0.1)


@pytest.mark.slow
def test_a_constant_mistake_is_the_network_s():
    """One step of v + (0.6, -0.8) lands 1 away from that of v: squared W2 grows by about 1."""
    exact = Exact("independent")

    def shifted(t, x, c):
        return exact(t, x, c) + torch.tensor([0.6, -0.8])

    budget = error_budget(shifted, Gaussian(), exact, nfe=1, n=800)
    assert budget.network == pytest.approx(1, abs=0.1)


def test_parts_sum_to_the_network_s_own_error():
    data, network = mixtures.petals(), VelocityMLP(2, 4, width=8, depth=1, seed=0)
    budget = error_budget(network, data, data.velocity, nfe=2, n=100, seed=3)
    alone = conditional_squared_w2(sampler(network, nfe=2), data, n=100, generator=seeded(3))
    parts = (budget.floor, budget.coupling, budget.discretisation, budget.network)
    assert sum(parts) == pytest.approx(alone)


def test_a_mixture_s_own_field_has_no_network_part():
    data = mixtures.rotating_pair()
    budget = error_budget(data.velocity, data, data.velocity, nfe=1, n=100)
    assert budget.network == 0
    assert budget.discretisation > 0.5


NAIVE = Exact(0.0)
Gap = partial(deployment_gap, NAIVE, Gaussian(), Independent())
Budget = partial(error_budget, NAIVE, Gaussian(), NAIVE)
FREE = unconditional(mixtures.petals())


test_bad_input = refused(
    (lambda: Gap(n=99), ValueError, "n must be at least 100"),
    (lambda: Gap(repetitions=1), ValueError, "repetitions must be at least 2"),
    (lambda: Gap(n=100, nfe=0), ValueError, "nfe must be at least 1"),
    (lambda: deployment_gap(NAIVE, FREE, Independent(), n=100), TypeError, "condition c, got None"),
    (lambda: Budget(nfe=0), ValueError, "nfe must be at least 1"),
    (lambda: Budget(nfe=1, n=0), ValueError, "n must be at least 1"),
)


class Map:
    """One step takes the noise x0 to 1 + x0 / 2, as naive OT pairs it with N(1, 1 / 4)."""

    dim = 2

    def __call__(self, t, x, c):
        return 1 - x / 2


@pytest.mark.slow
@pytest.mark.parametrize("columns", [1, 12])
def test_no_gap_on_rows_whose_condition_says_nothing(columns):
    """With the pair's own row as truth of fresh noise every one of these was flagged."""
    found = []
    for seed in range(12):
        g = seeded(seed)
        x1, c = 1 + torch.randn(1000, 2, generator=g) / 2, torch.randn(1000, columns, generator=g)
        found.append(deployment_gap(Map(), Dataset(x1, c), MinibatchOT(), n=100, seed=seed))
    assert sum(low <= 0 <= high for low, high in (gap.gap_interval for gap in found)) >= 10
    assert abs(np.mean([gap.gap for gap in found])) < 0.05 * np.mean([gap.fresh for gap in found])


def test_the_gap_of_skewed_rows_is_seen():
    x1, c = Gaussian().sample(2000, generator=seeded())
    gap = deployment_gap(Exact(0.0), Dataset(x1, c), MinibatchOT(), n=256)
    assert gap.gap == pytest.approx(PROBLEM.flow(0.0).squared_w2(1), rel=0.15)
    assert gap.gap_interval[0] > 0.5 * gap.gap


def test_related_rows_need_rows_that_are_held_out():
    """Every row stands ten times with nearly the same condition, as windows of one episode do."""
    g = seeded()
    x1, c = (
        (1 + torch.randn(300, 2, generator=g) / 2).repeat(10, 1),
        torch.randn(300, 1, generator=g),
    )
    c = c.repeat(10, 1) + 1e-4 * torch.randn(3000, 1, generator=g)
    rows = Dataset(x1 + 1e-4 * torch.randn(3000, 2, generator=g), c)
    fresh = Dataset(1 + torch.randn(3000, 2, generator=g) / 2, torch.randn(3000, 1, generator=g))
    related = deployment_gap(Map(), rows, MinibatchOT(), n=128)
    unrelated = deployment_gap(Map(), rows, MinibatchOT(), n=128, held_out=fresh)
    assert related.gap_interval[0] > 0.05
    assert abs(unrelated.gap) < 0.2 * related.gap


def test_labels_are_like_numbers():
    """Rows of one label are equally near: one of them is drawn."""
    x1 = torch.tensor([-2.0, 2.0]).repeat(500)[:, None] + torch.randn(1000, 1, generator=seeded())
    c = torch.tensor([0.0, 1.0]).repeat(500)[:, None]
    gap = deployment_gap(lambda t, x, c: 4 * c - 2, Dataset(x1, c), Independent(), n=400)
    assert gap.coupled == pytest.approx(0, abs=0.1)
    assert gap.gap == pytest.approx(0, abs=0.05)


def test_held_out_rows_are_the_truth():
    x1, c = Gaussian().sample(600, seeded())
    moved = Dataset(x1 + 10, c)
    call = partial(deployment_gap, Exact("independent"), Dataset(x1, c), Independent(), n=200)
    assert call(held_out=moved).coupled > call().coupled + 150


def test_a_batch_of_all_rows_is_refused():
    data = Dataset(*Gaussian().sample(150, seeded()))
    with pytest.raises(ValueError, match=r"n must leave rows .* got 140 of 150: .* held_out"):
        deployment_gap(Exact(0.0), data, MinibatchOT(), n=140)
