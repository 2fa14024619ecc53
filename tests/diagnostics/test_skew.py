"""The test of prior skew: its power on naive OT, and its level where there is no skew."""

import math

import numpy as np
import pytest
import torch
from support import joined, refused, seeded, take

from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.diagnostics import linear_skew, prior_skew, skew
from cotlearn.diagnostics.skew import unit_variance
from cotlearn.mixtures import fork, moons, moving_modes, petals, rotating_pair


def paired(coupling, data, *, batches=4, seed=0):
    pairs = take(coupling, data, batches, 128, generator=seeded(seed))
    return joined(pairs, "x0"), joined(pairs, "c")


every_mixture = pytest.mark.parametrize(
    "make", [moving_modes, petals, rotating_pair, fork, moons], ids=lambda make: make.__name__
)


@every_mixture
@pytest.mark.parametrize("seed", range(4))
def test_naive_ot_is_flagged(make, seed):
    result = prior_skew(*paired(MinibatchOT(), make(), seed=seed), generator=seeded(seed))
    assert result.flagged
    assert result.p_value < 0.005
    assert result.statistic > 0.1


@every_mixture
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("coupling", [Independent(), ConditionalOT(math.inf)], ids=repr)
def test_couplings_without_skew_are_not(make, seed, coupling):
    result = prior_skew(*paired(coupling, make(), seed=seed), generator=seeded(seed))
    assert not result.flagged
    assert abs(result.statistic) < 0.1


def test_the_label_decides_what_is_skewed():
    """Label "target" skews the prior where the weight is small, "source" never."""
    for label, expected in (("target", True), ("source", False)):
        pairs = paired(ConditionalOT(0.0, label=label), moving_modes())
        assert prior_skew(*pairs, generator=seeded()).flagged is expected


def test_the_statistic_falls_as_the_weight_grows():
    statistics = [
        prior_skew(*paired(ConditionalOT(w), petals(), batches=8), generator=seeded()).statistic
        for w in (0.0, 0.5, 2.0, 1e3)
    ]
    assert statistics == sorted(statistics, reverse=True)


def test_a_skew_that_neither_mean_nor_variance_shows():
    """x0 stays standard normal in each coordinate; only their product's sign follows c."""
    g = seeded()
    x0, c = torch.randn(1000, 2, generator=g), torch.randint(2, (1000, 1), generator=g).float()
    x0[:, 1] = x0[:, 1].abs() * x0[:, 0].sign() * (2 * c[:, 0] - 1)
    assert abs(np.corrcoef(x0[:, 0], c[:, 0])[0, 1]) < 0.1
    assert prior_skew(x0, c, generator=g).flagged


@pytest.mark.slow
def test_p_values_are_uniform_where_x0_and_c_are_independent(monkeypatch):
    monkeypatch.setattr(skew, "RELABELLINGS", 99)
    values = []
    for seed in range(300):
        g = seeded(seed)
        x0, c = torch.randn(150, 2, generator=g), torch.rand(150, 1, generator=g)
        values.append(prior_skew(x0, c, generator=g).p_value)
    for level in (0.01, 0.05, 0.2, 0.5, 0.8):  # within four standard errors
        share = np.mean(np.array(values) <= level)
        assert share == pytest.approx(level, abs=4 * math.sqrt(level * (1 - level) / 300))


def test_same_seed_same_numbers_and_inputs_unchanged():
    x0, c = paired(MinibatchOT(), petals(), batches=1)
    before = x0.clone(), c.clone()
    assert prior_skew(x0, c, generator=seeded(1)) == prior_skew(x0, c, generator=seeded(1))
    assert all(map(torch.equal, (x0, c), before))


def test_scale_does_not_matter():
    x0, c = paired(MinibatchOT(), moving_modes(), batches=2)
    plain = prior_skew(x0.double(), c.double(), generator=seeded(1))
    scaled = prior_skew(x0.double() * 1024, c.double() / 64, generator=seeded(1))
    assert scaled == plain


def test_conditions_that_are_constant_or_labels():
    x0 = torch.randn(200, 2, generator=seeded())
    assert not prior_skew(x0, torch.full((200, 20), 0.1), generator=seeded()).flagged
    assert prior_skew(x0, (x0[:, :1] > 0).long(), generator=seeded()).flagged


def test_unit_variance_leaves_constants_out():
    values = np.random.default_rng(0).normal(size=(500, 3)) * [1, 10, 0] + [0, 0, 0.1]
    scaled = unit_variance(values)
    assert (scaled[:, 2] == 0).all()
    distances = ((scaled[:, None] - scaled[None]) ** 2).sum(axis=2)
    assert distances.mean() == pytest.approx(2, rel=1e-6)


GIVEN = {"x0": torch.randn(200, 2), "c": torch.randn(200, 1)}
test_bad_input = refused(
    ({"x0": torch.zeros(99, 2), "c": torch.zeros(99, 1)}, ValueError, "at least 100 rows"),
    ({"c": torch.zeros(100, 1)}, ValueError, "c has 100 rows, x0 has 200"),
    ({"c": torch.zeros(200)}, ValueError, "c must have shape"),
    ({"c": None}, TypeError, "c must be a torch tensor"),
    ({"x0": torch.full((200, 2), math.nan)}, ValueError, "x0 has NaN"),
    ({"c": torch.full((200, 2), math.inf)}, ValueError, "c has NaN or infinite"),
    of=lambda **options: prior_skew(**(GIVEN | options)),
)


def test_values_whose_squares_overflow_are_refused():
    """At 1e160 a condition that is the noise itself was not flagged."""
    x = torch.randn(200, 2, generator=seeded()).double()
    for test in (prior_skew, linear_skew):
        with pytest.raises(ValueError, match="whose squares float64 holds; c has values up to"):
            test(x, 1e160 * x)


def test_repeated_noise_is_named():
    """It is its own neighbour, so that independent rows were flagged without a word."""
    x0, c = torch.randn(300, 2, generator=seeded()), torch.randn(300, 1, generator=seeded(1))
    with pytest.warns(RuntimeWarning, match="x0 has only 300 different rows of 600"):
        prior_skew(x0.repeat(2, 1), c.repeat(2, 1))
