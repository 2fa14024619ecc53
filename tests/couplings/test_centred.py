"""Pairs about the mean that a condition foretells: what is its own, beside test_wrapped.py."""

import math

import pytest
import torch

from cotlearn.couplings import (
    Centred,
    ConditionalOT,
    Independent,
    MinibatchOT,
    StratifiedOT,
)
from cotlearn.diagnostics import linear_skew


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def mean(c):
    return torch.cat([3 * (2 * c).sin(), 2 * c], dim=1)


def spread(c):
    return 0.3 + c.abs()


def family(n, seed=0, scaled=True):
    """A location-scale family: two modes about a mean, at a distance, that follow c."""
    rng = seeded(seed)
    c = 2 * torch.rand(n, 1, generator=rng) - 1
    modes = 2.0 * torch.randint(0, 2, (n, 1), generator=rng) - 1
    left = 0.3 * torch.randn(n, 2, generator=rng) + modes * torch.tensor([0.0, 1.0])
    return mean(c) + (spread(c) if scaled else 1.0) * left, c


def rows_of(x1, c):
    return torch.cat([x1, c], dim=1).double()


def centred(coupling, scaled=True):
    return Centred(coupling, mean, spread if scaled else None)


def pairs_of(coupling, n=4096, seed=0):
    x1, c = family(n, seed)
    return x1, c, coupling(torch.randn(n, 2, generator=seeded(seed + 1)), x1, c, seeded(seed + 2))


def test_the_mean_alone_leaves_the_length_of_noise_to_the_condition():
    """Without its spread the family is centred only by half; squares of x0 tell so."""

    def told(coupling):
        *_, pairs = pairs_of(coupling)
        return linear_skew(pairs.x0.square(), pairs.c, degree=2).explained

    assert told(centred(MinibatchOT(), scaled=False)) > 0.05
    assert abs(told(centred(MinibatchOT()))) < 0.01


def test_within_one_condition_it_pairs_as_the_coupling_inside():
    """Neither a shift nor one number for the spread changes which pairing is the cheapest."""
    x1, _ = family(200)
    c = torch.full((200, 1), 0.4)
    x0 = torch.randn(200, 2, generator=seeded(5))
    plain = MinibatchOT()(x0, x1, c, seeded())
    about = centred(MinibatchOT())(x0, x1, c, seeded())
    cost = [float((p.x0 - p.x1).square().sum()) for p in (plain, about)]
    assert cost[1] == pytest.approx(cost[0], rel=1e-5)


def test_a_linear_mean_in_one_stratum_is_that_of_stratified_ot():
    """`StratifiedOT(residual=True)` regresses inside strata; with one, that is a global line."""
    x1, c = family(400, scaled=False)
    x0 = torch.randn(400, 2, generator=seeded(1))
    features = torch.cat([torch.ones_like(c), c], dim=1)
    weights = torch.linalg.lstsq(features.double(), x1.double()).solution.float()

    def line(some):
        return torch.cat([torch.ones_like(some), some], dim=1) @ weights

    one = Centred(StratifiedOT(1), line)(x0, x1, c, seeded())
    two = StratifiedOT(1, residual=True)(x0, x1, c, seeded())
    costs = [float((p.x0 - (p.x1 - line(p.c))).square().sum()) for p in (one, two)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)
    assert (one.target_index == two.target_index).float().mean() > 0.9  # but for ties by rounding


def test_a_mean_of_nothing_changes_nothing():
    still = Centred(ConditionalOT(2.0), lambda c: torch.zeros(len(c), 2))
    _, _, one = pairs_of(still, n=300)
    _, _, two = pairs_of(ConditionalOT(2.0), n=300)
    assert torch.equal(one.x0, two.x0)
    assert torch.equal(one.x1, two.x1)


def test_its_words_name_what_is_inside():
    words = repr(centred(ConditionalOT(2.0)))
    assert words.startswith("Centred(ConditionalOT(condition_weight=2.0")
    assert words.endswith("mean, spread)")
    assert repr(centred(Independent(), scaled=False)).endswith("mean)")


X, C = torch.randn(20, 2), torch.randn(20, 1)


def about(mean, spread=None):
    return Centred(MinibatchOT(), mean, spread)(X, X, C)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Centred(MinibatchOT(), None), TypeError, "mean must be a function of c"),
        (lambda: Centred(MinibatchOT(), mean, 3), TypeError, "spread must be a function of c"),
        (lambda: about(lambda c: c), ValueError, r"mean must .* \(20, 2\), got \(20, 1\)"),
        (lambda: about(lambda c: 0.0), ValueError, "mean must .* got float"),
        (lambda: about(lambda c: mean(c) / 0), ValueError, "mean must return finite"),
        (
            lambda: about(mean, lambda c: c[0]),
            ValueError,
            r"spread must .* \(20, 1\) or \(20, 2\), got \(1,\)",
        ),
        (lambda: about(mean, lambda c: -c.abs()), ValueError, "spread must be positive, got -"),
        (lambda: about(mean, lambda c: c * math.nan), ValueError, "spread must return finite"),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call()
