"""The probe: one Euler step, learned from pairs and scored on held-out rows."""

import torch

from cotlearn import mixtures
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.couplings.base import Pairs
from cotlearn.datasets import Dataset
from cotlearn.diagnostics.probe import one_step_scores
from cotlearn.metrics import energy_score, energy_scores


def pairs_of(coupling, data, batches=8, seed=0):
    stream = coupling.stream(data, batch_size=128, generator=torch.Generator().manual_seed(seed))
    return Pairs.cat([next(stream) for _ in range(batches)])


def test_it_ranks_couplings_as_training_does():
    """Petals: COT is best at one step; the score is that of samples at fresh noise."""
    x1, c = mixtures.petals().sample(1200, generator=torch.Generator().manual_seed(0))
    train, test = Dataset(x1[:900], c[:900]), Dataset(x1[900:], c[900:])
    couplings = {"free": Independent(), "blind": MinibatchOT(), "cot": ConditionalOT(float("inf"))}
    scores = {
        name: one_step_scores(pairs_of(coupling, train), test, steps=300)
        for name, coupling in couplings.items()
    }
    assert scores["cot"].shape == (300,)
    means = {name: float(value.mean()) for name, value in scores.items()}
    assert means["cot"] < 0.9 * min(means["free"], means["blind"])
    again = one_step_scores(pairs_of(couplings["cot"], train), test, steps=300)
    assert torch.equal(again, scores["cot"])


def test_scores_average_to_the_score():
    g = torch.Generator().manual_seed(0)
    samples, truth = torch.randn(4, 9, 3, generator=g), torch.randn(9, 3, generator=g)
    each = energy_scores(samples, truth)
    assert each.shape == (9,)
    assert float(each.mean()) == energy_score(samples, truth)
