"""What `Framed` and `Centred` share: another coupling pairs, the data stay, the prior stays blind.

Each wrapper has a problem whose data, as they are seen from their condition, do not depend on it.
"""

import math

import pytest
import torch

from cotlearn.couplings import (
    Centred,
    ConditionalOT,
    Framed,
    Independent,
    MinibatchOT,
    ModelAligned,
    StratifiedOT,
)
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier, linear_skew, prior_skew
from cotlearn.mixtures import rotating_pair

INNER = [MinibatchOT(), ConditionalOT(3.0), StratifiedOT(8)]


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


class Turned:
    """Both modes lie in the direction of the angle pi/2 c."""

    endless = rotating_pair()

    def data(self, n, seed=0):
        return self.endless.sample(n, generator=seeded(seed))

    def wrap(self, coupling):
        def turn(x, angle):
            cos, sin = angle[:, 0].cos(), angle[:, 0].sin()
            return torch.stack([cos * x[:, 0] - sin * x[:, 1], sin * x[:, 0] + cos * x[:, 1]], 1)

        return Framed(
            coupling, lambda x, c: turn(x, -math.pi / 2 * c), lambda x, c: turn(x, math.pi / 2 * c)
        )


class Shifted:
    """A location-scale family: two modes about a mean, at a distance, that follow c."""

    @property
    def endless(self):
        return self

    def sample(self, n, generator=None):
        c = 2 * torch.rand(n, 1, generator=generator) - 1
        modes = 2.0 * torch.randint(0, 2, (n, 1), generator=generator) - 1
        left = 0.3 * torch.randn(n, 2, generator=generator) + modes * torch.tensor([0.0, 1.0])
        return self.mean(c) + self.spread(c) * left, c

    def data(self, n, seed=0):
        return self.sample(n, generator=seeded(seed))

    @staticmethod
    def mean(c):
        return torch.cat([3 * (2 * c).sin(), 2 * c], dim=1)

    @staticmethod
    def spread(c):
        return 0.3 + c.abs()

    def wrap(self, coupling):
        return Centred(coupling, self.mean, self.spread)


@pytest.fixture(params=[Turned(), Shifted()], ids=["framed", "centred"])
def problem(request):
    return request.param


def pairs_of(problem, coupling, n=4096, seed=0):
    x1, c = problem.data(n, seed)
    x0 = torch.randn(n, 2, generator=seeded(seed + 1))
    return x1, c, problem.wrap(coupling)(x0, x1, c, seeded(seed + 2))


def test_data_keep_their_conditions(problem):
    x1, c, pairs = pairs_of(problem, MinibatchOT(), n=500)
    assert torch.equal(pairs.c, c[pairs.target_index])
    assert torch.allclose(pairs.x1, x1[pairs.target_index], atol=1e-5)
    assert sorted(pairs.target_index.tolist()) == list(range(500))


def test_naive_ot_inside_does_not_skew_and_straightens_the_most(problem):
    """Seen from the condition the data are the same for every c: there is nothing to know."""
    x1, c = problem.data(4000)
    couplings = {
        "independent": Independent(),
        "naive": MinibatchOT(),
        "wrapped": problem.wrap(MinibatchOT()),
    }
    found = frontier(x1, c, couplings, rows=2048, progress=False)
    assert found["naive"].flagged
    assert not found["wrapped"].flagged
    assert found["wrapped"].candidates == 256
    variance = {point.name: point.one_step_variance for point in found}
    assert variance["wrapped"] < 0.4 * variance["independent"]


@pytest.mark.parametrize("seed", range(3))
def test_the_noise_stays_standard_normal_and_blind(problem, seed):
    *_, pairs = pairs_of(problem, MinibatchOT(), n=2048, seed=10 * seed)
    assert pairs.x0.mean(dim=0).abs().max() < 0.09
    assert (pairs.x0.T.cov() - torch.eye(2)).abs().max() < 0.17
    assert prior_skew(pairs.x0, pairs.c).p_value > 1e-4
    assert linear_skew(pairs.x0, pairs.c, degree=2).p_value > 1e-4


@pytest.mark.parametrize("inner", INNER, ids=repr)
def test_streams(problem, inner):
    coupling = problem.wrap(inner)
    x1, c = problem.data(600)
    data = Dataset(x1, c)

    def first(n, start=0):
        stream = coupling.stream(data, batch_size=100, generator=seeded(3), start=start)
        return [next(stream) for _ in range(n)]

    def rows(x, condition):
        return torch.cat([x, condition], dim=1).double()

    batches = first(6)
    for batch in batches:  # each row is one of the data, with its own condition
        distance = torch.cdist(rows(batch.x1, batch.c), rows(x1, c))
        assert distance.min(dim=1).values.max() < 1e-3
    assert torch.equal(first(2, start=4)[1].x0, batches[5].x0)  # resumed


@pytest.mark.parametrize("inner", INNER, ids=repr)
def test_it_passes_for_the_coupling_inside(problem, inner):
    coupling = problem.wrap(inner)
    data = Dataset(*problem.data(600))
    assert coupling.epoch_rows(data) == inner.epoch_rows(data)
    for name in ("name", "uses_ot_batch", "whole_data", "solves"):
        assert getattr(coupling, name) == getattr(inner, name)
    assert repr(coupling).startswith(f"{type(coupling).__name__}({inner!r}, ")


def test_endless_data(problem):
    stream = problem.wrap(MinibatchOT()).stream(problem.endless, batch_size=64, generator=seeded())
    batch = next(stream)
    assert len(batch) == 64
    distance = torch.cdist(batch.x1, problem.data(20_000)[0]).min(dim=1).values
    assert distance.max() < 0.5


X, C = torch.randn(20, 2), torch.randn(20, 1)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda wrap: wrap("exact"), TypeError, "coupling must be a Coupling"),
        (lambda wrap: wrap(ModelAligned("weighted")), ValueError, "ask the network"),
        (lambda wrap: wrap(ConditionalOT(1.0, label="source")), ValueError, "source's label"),
        (lambda wrap: wrap(MinibatchOT())(X, X), TypeError, "needs the conditions c"),
        (lambda wrap: wrap(MinibatchOT())(X, X[:9], C), ValueError, "x1 has 9 rows"),
        (
            lambda wrap: next(wrap(StratifiedOT(2)).stream(Shifted(), batch_size=8)),
            TypeError,
            "endless",
        ),
    ],
)
def test_bad_input(problem, call, error, message):
    with pytest.raises(error, match=message):
        call(problem.wrap)
