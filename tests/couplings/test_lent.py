"""A user's function gets copies: it may overwrite what it is given."""

import numpy as np
import pytest
import torch
from support import seeded

from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    EmbeddedClusters,
    KMeansCondition,
    MinibatchOT,
    ModelAligned,
    Reflow,
    SemidiscreteOT,
    StratifiedBatches,
    StratifiedOT,
    Transformed,
    centred,
)
from cotlearn.couplings.base import Match
from cotlearn.datasets import Dataset
from cotlearn.flows import integrate
from cotlearn.flows.one_step import Drifting


def twice(x, *more):
    """Writes in place, in everything that it is given."""
    for value in more:
        if isinstance(value, torch.Tensor):
            value.mul_(3)
    return x.mul_(2)


class Writing(Coupling):
    def match(self, x0, x1, c, rng):
        twice(x0, x1, c)
        return Match(np.arange(len(x0)), np.arange(len(x0)))


class Heavy(ConditionalOT):
    def weight(self, sample_cost, condition_cost, index):
        sample_cost *= 0
        index[:] = 0
        return 4.0


class Network(torch.nn.Module):
    def forward(self, t, x, c):
        return twice(x, c, t)


def aligned(variant):
    coupling = ModelAligned(variant)
    coupling.observe(Network(), 0)
    return coupling


COUPLINGS = [
    EmbeddedClusters(twice, KMeansCondition(4)),
    Reflow(twice),
    ConditionalOT(condition=twice),
    Heavy(),
    centred(MinibatchOT(), twice, lambda c: twice(c).abs() + 1),
    Transformed(MinibatchOT(), twice),
    Transformed(MinibatchOT(), lambda x, c: twice(x, c) / 2, lambda x, c: twice(x, c) / 2),
    Writing(),
    Transformed(Writing(), lambda x, c: x),
    aligned("weighted"),
    aligned("full"),
]


@pytest.mark.filterwarnings("ignore:StratifiedOT was called")
@pytest.mark.parametrize("coupling", COUPLINGS, ids=lambda k: repr(k)[:40])
def test_a_function_that_writes_in_place_changes_nothing(coupling):
    if isinstance(coupling, EmbeddedClusters):
        coupling = StratifiedOT(coupling)
    given = [torch.randn(16, 2, generator=seeded(k)) for k in range(3)]
    before = [value.clone() for value in given]
    pairs = coupling(*given, generator=seeded(5))
    assert all(map(torch.equal, given, before))
    assert torch.equal(pairs.c, before[2][pairs.target_index])
    assert same_again(coupling, given, pairs)


def same_again(coupling, given, pairs):
    again = coupling(*given, generator=seeded(5))
    return torch.equal(pairs.target_index, again.target_index) and torch.equal(pairs.x1, again.x1)


def test_a_weight_that_overwrites_the_costs_pairs_as_one_that_does_not():
    given = [torch.randn(64, 2, generator=seeded(k)) for k in range(3)]

    class Plain(ConditionalOT):
        def weight(self, sample_cost, condition_cost, index):
            return 4.0

    one, two = (kind()(*given, generator=seeded(5)) for kind in (Plain, Heavy))
    assert torch.equal(one.target_index, two.target_index)


def test_a_velocity_that_writes_into_its_condition_leaves_it_alone():
    x0, c = torch.randn(4, 2), torch.ones(4, 2)
    integrate(lambda t, x, c: twice(c, x), x0, c, nfe=3)
    Drifting().sample(Network(), x0, c)
    assert torch.equal(c, torch.ones(4, 2))
    assert torch.allclose(integrate(lambda t, x, c: twice(c, x), x0, c, nfe=4).x1, x0 + 2)


@pytest.mark.parametrize("coupling", [SemidiscreteOT(), StratifiedBatches(), MinibatchOT()])
def test_a_source_may_return_the_same_buffer_each_time(coupling):
    """Four batches of a stream held the noise of the last one."""
    buffer, data = torch.empty(64, 2), Dataset(*torch.randn(2, 200, 2, generator=seeded()))

    def source(n, generator=None):
        given = buffer if n == 64 else torch.empty(n, 2)
        return given.normal_(generator=generator)

    stream = coupling.stream(data, batch_size=64, source=source, generator=seeded())
    rows = torch.cat([next(stream).x0 for _ in range(4)])
    assert len(rows.unique(dim=0)) == 256
