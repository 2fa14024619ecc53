"""C2OT's weight search, against r(w) computed entry by entry."""

import math
import warnings

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import AdaptiveConditionalOT, ConditionalOT, MinibatchOT
from cotlearn.couplings.distances import squared_distances

STEP = 2 ** (1 / 16)


def batch(n=24, seed=0, scale=1.0):
    """x1 follows c; every condition differs."""
    g = seeded(seed)
    c = torch.randn(n, 2, generator=g)
    x1 = 2 * c + 0.3 * torch.randn(n, 2, generator=g)
    return torch.randn(n, 2, generator=g), x1, scale * c


def costs(x0, x1, c, own):
    """M and C, entry by entry; noise row i has the condition of row own[i]."""
    M = [[float(((a - b) ** 2).sum()) for b in x1.double()] for a in x0.double()]
    C = [[float(((a - b) ** 2).sum()) for b in c.double()] for a in c[own].double()]
    return np.array(M), np.array(C)


def naive_ratio(weight, M, C, own):
    """r(w) = mean_ij [ M_ij + w C_ij <= M_jj ], M_jj with the noise that has condition j."""
    total = np.where(C > 0, math.inf, M) if math.isinf(weight) else M + weight * C
    return np.mean(total <= M[np.argsort(own), np.arange(len(M))])


class Watched(AdaptiveConditionalOT):
    """Keeps what the weight was computed from."""

    def weight(self, sample_cost, condition_cost, own):
        self.own, self.condition_matrix = own, condition_cost
        self.found = super().weight(sample_cost, condition_cost, own)
        return self.found


def watched(target, x0, x1, c):
    """A coupling that has seen this batch."""
    coupling = Watched(target)
    coupling(x0, x1, c, generator=seeded())
    return coupling


@pytest.mark.parametrize("target", [0.06, 0.15, 0.3])
def test_the_weight_is_the_smallest_of_the_grid_that_meets_the_target(target):
    x0, x1, c = batch()
    coupling = watched(target, x0, x1, c)
    M, C = costs(x0, x1, c, coupling.own)
    np.testing.assert_allclose(coupling.condition_matrix, C, atol=1e-9)
    w = coupling.found
    k = 16 * math.log2(w)
    assert abs(k - round(k)) < 1e-6  # on the grid
    assert naive_ratio(w, M, C, coupling.own) <= target
    assert naive_ratio(w / STEP, M, C, coupling.own) > target


def test_the_pairing_is_conditional_ot_with_that_weight():
    x0, x1, c = batch(40)
    coupling = Watched(0.1)
    pairs = coupling(x0, x1, c, generator=seeded(3))
    expected = ConditionalOT(coupling.found)(x0, x1, c, generator=seeded(3))
    assert torch.equal(pairs.target_index, expected.target_index)
    assert torch.equal(pairs.c, c[pairs.target_index])


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1.0, 1e4, 1e9])
def test_the_weight_follows_the_scale_of_the_condition(scale):
    found, at_scale_one = (watched(0.1, *batch(scale=s)).found for s in (scale, 1.0))
    assert found * scale**2 == pytest.approx(at_scale_one, rel=STEP - 1 + 1e-6)


def test_where_any_positive_weight_will_do():
    """Noise rows that are equal: r(0) counts ties, which the smallest weight breaks."""
    x0, x1, c = batch(12)
    assert 0 < watched(0.5, x0[:1].expand(12, -1).clone(), x1, c).found < 1e-9


def test_a_target_that_holds_already_gives_zero_which_does_not_stick():
    x0, x1, c = batch()
    coupling = Watched(0.95)
    pairs = coupling(x0, x1, c, generator=seeded())
    assert coupling.found == 0
    assert torch.equal(pairs.target_index, MinibatchOT()(x0, x1, c).target_index)
    coupling.target_ratio = 0.05
    coupling(x0, x1, c, generator=seeded())
    assert coupling.found > 0


def test_plain_ot_has_a_ratio_of_about_a_half():
    x0, x1, c = batch(100)
    own = np.random.default_rng(0).permutation(100)
    M, C = squared_distances(x0, x1), squared_distances(c[torch.from_numpy(own)], c)
    partner = np.argsort(own)
    assert (M[partner, np.arange(100)] >= M).mean() == pytest.approx(0.5, abs=0.1)
    assert Watched(0.9).weight(M, C, own) == 0


@pytest.mark.parametrize("classes", [2, 5])
def test_tied_classes_cannot_go_below_r_of_infinity(classes):
    """It is (1/K + 1/B)/2 on average; the warning names it, and the weight reaches it."""
    n, lowest = 60, []
    for seed in range(30):
        x0, x1, _ = batch(n, seed=seed)
        c = torch.eye(classes)[torch.arange(n) % classes]
        coupling = Watched(0.01)
        with pytest.warns(UserWarning, match=r"target_ratio 0.01 cannot be met.*r\(inf") as said:
            coupling(x0, x1, c, generator=seeded(seed))
        lowest.append(float(str(said[0].message).split("r(infinity) = ")[1].split()[0]))
        if seed < 2:
            M, C = costs(x0, x1, c, coupling.own)
            at_infinity = naive_ratio(math.inf, M, C, coupling.own)
            assert lowest[-1] == pytest.approx(at_infinity, rel=1e-3)
            assert naive_ratio(coupling.found, M, C, coupling.own) == at_infinity
            assert naive_ratio(coupling.found / STEP, M, C, coupling.own) > at_infinity
    assert np.mean(lowest) == pytest.approx((1 / classes + 1 / n) / 2, rel=0.05)


@pytest.mark.parametrize("rows", [1, 2, 4, 6, 16])
def test_a_small_last_batch_of_an_epoch(rows):
    """All conditions differ: r(infinity) is 1/B, and only a row's own condition is left."""
    x0, x1, c = batch(rows)
    coupling = Watched(0.05)
    with pytest.warns(UserWarning, match=rf"r\(infinity\) = {1 / rows:.4g} "):
        pairs = coupling(x0, x1, c, generator=seeded())
    assert naive_ratio(coupling.found, *costs(x0, x1, c, coupling.own), coupling.own) == 1 / rows
    assert torch.equal(pairs.target_index, torch.from_numpy(coupling.own))


def test_what_cannot_be_met_is_said_once():
    coupling = AdaptiveConditionalOT(0.05)
    with pytest.warns(UserWarning, match="cannot be met"):
        coupling(*batch(10), generator=seeded())
    with warnings.catch_warnings(action="error"):
        coupling(*batch(10, seed=1), generator=seeded())


def test_a_target_above_r_of_infinity_separates_tied_classes():
    x0, x1, _ = batch(60)
    c = torch.eye(3)[torch.arange(60) % 3]
    coupling = watched(0.25, x0, x1, c)
    M, C = costs(x0, x1, c, coupling.own)
    assert naive_ratio(coupling.found, M, C, coupling.own) <= 0.25


def call(target, x0, x1, c=None):
    return AdaptiveConditionalOT(target)(x0, x1, c, generator=seeded())


def test_the_cosine_sees_directions_only():
    x0, x1, c = batch()
    lengths = torch.linspace(0.1, 50, len(c))[:, None]
    unit = torch.nn.functional.normalize
    one, other = Watched(0.1, condition=unit), Watched(0.1, condition=unit)
    first = one(x0, x1, c, generator=seeded())
    second = other(x0, x1, c * lengths, generator=seeded())
    assert one.found == other.found
    assert torch.equal(first.target_index, second.target_index)
    distance = 1 - torch.nn.functional.cosine_similarity(c[one.own][:, None], c[None], dim=2)
    np.testing.assert_allclose(one.condition_matrix, 2 * distance, atol=1e-5)


def test_integer_and_bool_conditions():
    x0, x1, c = batch(30)
    numbers = (10 * c).round()
    expected = call(0.2, x0, x1, numbers).target_index
    assert torch.equal(call(0.2, x0, x1, numbers.int()).target_index, expected)
    call(0.4, x0, x1, numbers > 0)


X0, X1, _ = batch()
test_bad_input = refused(
    (lambda: AdaptiveConditionalOT(0.0), ValueError, "target_ratio must lie between"),
    (lambda: AdaptiveConditionalOT(1.0), ValueError, "target_ratio must lie between"),
    (lambda: AdaptiveConditionalOT(math.nan), ValueError, "target_ratio"),
    (lambda: AdaptiveConditionalOT("small"), TypeError, "target_ratio must be a number"),
    (lambda: AdaptiveConditionalOT()(X0, X1), TypeError, "needs the conditions c"),
)


def test_constant_conditions_weigh_nothing():
    with pytest.warns(UserWarning, match=r"r\(infinity\) = 0\.\d"):
        pairs = call(0.05, X0, X1, torch.ones(24, 2))
    assert torch.equal(pairs.target_index, MinibatchOT()(X0, X1).target_index)


def test_candidates_do_not_depend_on_whether_the_rows_are_pairs_already():
    x0, x1, c = batch(200)
    coupling = AdaptiveConditionalOT(0.05)
    paired = coupling(x0, x1, c, generator=seeded(1))
    before = coupling.candidates(x0, x1, c)
    after = coupling.candidates(paired.x0, paired.x1, paired.c)
    assert after == pytest.approx(before, rel=0.3)  # it was three times as many


def test_a_ratio_that_is_set_later_is_checked():
    coupling = AdaptiveConditionalOT(0.05)
    coupling.target_ratio = 5
    with pytest.raises(ValueError, match="target_ratio must lie between 0 and 1"):
        coupling(torch.randn(8, 2), torch.randn(8, 2), torch.eye(8))
