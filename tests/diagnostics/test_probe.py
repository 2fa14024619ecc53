"""The probe: one Euler step, learned from pairs and scored on held-out rows."""

import pytest
import torch
from support import seeded, take

from cotlearn import mixtures
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.couplings.base import Pairs
from cotlearn.datasets import Dataset
from cotlearn.diagnostics.probe import one_step_scores
from cotlearn.metrics import energy_score, energy_scores


def scores_of(coupling, train, test):
    pairs = Pairs.cat(take(coupling, train, 8, 128, generator=seeded()))
    return one_step_scores(pairs, test, steps=300)


@pytest.mark.slow
def test_it_ranks_couplings_as_training_does():
    """Petals: COT is best at one step; the score is that of samples at fresh noise."""
    x1, c = mixtures.petals().sample(1200, generator=seeded())
    train, test = Dataset(x1[:900], c[:900]), Dataset(x1[900:], c[900:])
    couplings = {"free": Independent(), "blind": MinibatchOT(), "cot": ConditionalOT(float("inf"))}
    scores = {name: scores_of(coupling, train, test) for name, coupling in couplings.items()}
    assert scores["cot"].shape == (300,)
    means = {name: float(value.mean()) for name, value in scores.items()}
    assert means["cot"] < 0.9 * min(means["free"], means["blind"])
    assert torch.equal(scores_of(couplings["cot"], train, test), scores["cot"])


def test_scores_average_to_the_score():
    g = seeded()
    samples, truth = torch.randn(4, 9, 3, generator=g), torch.randn(9, 3, generator=g)
    each = energy_scores(samples, truth)
    assert each.shape == (9,)
    assert float(each.mean()) == energy_score(samples, truth)
