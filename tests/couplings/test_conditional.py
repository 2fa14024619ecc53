"""Conditional optimal transport: its two ends, its rule for the weight, its two labels."""

import math
import warnings

import numpy as np
import ot
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from support import refused, seeded

from cotlearn.couplings import AdaptiveConditionalOT, ConditionalOT, MinibatchOT
from cotlearn.couplings.base import Pairs


def labelled(n=60, k=3, seed=0):
    g = seeded(seed)
    c = torch.eye(k)[torch.randint(k, (n,), generator=g)]
    return torch.randn(n, 2, generator=g), torch.randn(n, 2, generator=g) + 3 * c[:, :2], c


def continuous(n=60, seed=0):
    g = seeded(seed)
    c = torch.rand(n, 1, generator=g)
    return torch.randn(n, 2, generator=g), torch.randn(n, 2, generator=g) + 3 * c, c


def cost(pairs):
    return float((pairs.x0.double() - pairs.x1).square().sum(dim=1).sum())


class Recording(ConditionalOT):
    """Keeps what `match` drew and weighed."""

    def _joint_cost(self, x0, x1, c, own, order):
        self._own, self._weight = order[own], self.condition_weight
        return super()._joint_cost(x0, x1, c, own, order)

    def weight(self, sample_cost, condition_cost, own):
        self._weight = super().weight(sample_cost, condition_cost, own)
        self._costs = sample_cost, condition_cost
        return self._weight


@pytest.mark.parametrize("n", [40, 130])
def test_weight_zero_is_minibatch_ot(n):
    x0, x1, c = continuous(n)
    naive = MinibatchOT()(x0, x1, c)
    pairs = ConditionalOT(0.0)(x0, x1, c)
    assert torch.equal(pairs.target_index, naive.target_index)
    assert torch.equal(pairs.c, naive.c)


def assert_equal_conditions_meet(pairs, c):
    """There is a permutation c0 of c that the plan never changes: class by class as many."""
    assert torch.equal(pairs.source_index.sort().values, torch.arange(len(c)))
    assert torch.equal(pairs.target_index.sort().values, torch.arange(len(c)))


def test_infinite_weight_on_labels_is_the_exact_plan_of_each_class():
    x0, x1, c = labelled()
    # label="source" gives the class that each noise row was given: at infinity both labels agree
    own = ConditionalOT(math.inf, label="source")(x0, x1, c, generator=seeded(3))
    pairs = ConditionalOT(math.inf)(x0, x1, c, generator=seeded(3))
    assert torch.equal(own.source_index, pairs.source_index)
    assert torch.equal(own.c, pairs.c)
    assert_equal_conditions_meet(pairs, c)
    for k in range(3):
        rows = pairs.c[:, k] == 1
        a, b = pairs.x0[rows].double().numpy(), x1[c[:, k] == 1].double().numpy()
        weights = np.full(len(a), 1 / len(a))
        assert len(a) == len(b)
        expected = ot.emd2(weights, weights, ot.dist(a, b)) * len(a)
        got = float((pairs.x0[rows] - pairs.x1[rows]).square().sum())
        assert got == pytest.approx(expected, rel=1e-4)


def test_a_large_weight_on_labels_is_the_infinite_one():
    x0, x1, c = labelled(130)
    found = [ConditionalOT(w)(x0, x1, c, generator=seeded(3)) for w in (1e6, math.inf)]
    assert cost(found[0]) == pytest.approx(cost(found[1]), rel=1e-6)
    assert torch.equal(*(pairs.target_index[pairs.source_index.argsort()] for pairs in found))


def test_infinite_weight_with_all_conditions_different_pairs_equal_conditions_only():
    """Then the pairing does not look at x at all: the independent coupling."""
    x0, x1, c = continuous()
    first = ConditionalOT(math.inf, label="source")(x0, x1, c, generator=seeded(1))
    assert torch.equal(first.c, c[first.target_index])
    moved = ConditionalOT(math.inf)(x0.flip(0), x1 * 7, c, generator=seeded(1))
    assert torch.equal(moved.source_index, first.source_index)
    assert torch.equal(moved.target_index, first.target_index)
    assert not torch.equal(first.source_index, first.target_index)  # c0 is a shuffled copy


@pytest.mark.parametrize("weight", [0.5, 5.0, 200.0, "balanced"])
@pytest.mark.parametrize("make", [labelled, continuous])
def test_the_plan_is_optimal_for_the_whole_cost(weight, make):
    x0, x1, c = make()
    coupling = Recording(weight)
    pairs = coupling(x0, x1, c, generator=seeded(5))
    own, w = coupling._own, coupling._weight
    assert sorted(own) == list(range(len(c)))  # c0 is a permutation of the batch's conditions
    total = cdist(x0, x1, "sqeuclidean") + w * cdist(c[own], c, "sqeuclidean")
    best = total[linear_sum_assignment(total)].sum()
    got = total[pairs.source_index, pairs.target_index].sum()
    assert got == pytest.approx(best, rel=1e-9)


def test_between_the_ends_the_sample_cost_rises_and_the_condition_cost_falls():
    x0, x1, c = continuous(130)
    sample, condition = [], []
    for w in (0.0, 1.0, 10.0, 100.0, 1e4):
        pairs = ConditionalOT(w, label="target")(x0, x1, c, generator=seeded(2))
        own = ConditionalOT(w, label="source")(x0, x1, c, generator=seeded(2))
        sample.append(cost(pairs))
        condition.append(float((pairs.c - own.c).square().sum()))
    assert sample == sorted(sample)
    assert condition == sorted(condition, reverse=True)
    assert condition[-1] < 1e-3 * condition[0]


@pytest.mark.parametrize("make", [labelled, continuous])
def test_balanced_is_the_published_rule(make):
    x0, x1, c = make()
    coupling = Recording("balanced")
    coupling(x0, x1, c, generator=seeded(4))
    (sample_cost, condition_cost), own, w = coupling._costs, coupling._own, coupling._weight
    c0 = c[torch.from_numpy(own)]
    g = 10 * torch.cdist(x0.double(), x1.double()).mean() / torch.cdist(c0, c).double().mean()
    assert w == pytest.approx(float(g) ** 2, rel=1e-4)
    assert 30 < w * condition_cost.mean() / sample_cost.mean() < 300  # about 100 times


def test_balanced_does_not_depend_on_the_scale_of_the_condition():
    x0, x1, c = continuous()
    pairs = ConditionalOT()(x0, x1, c, generator=seeded(1))
    scaled = ConditionalOT("balanced")(x0, x1, 1e3 * c, generator=seeded(1))
    assert torch.equal(pairs.target_index, scaled.target_index)


@pytest.mark.parametrize("weight", [0.0, 7.0, math.inf, "balanced"])
def test_constant_conditions_leave_minibatch_ot(weight):
    x0, x1, _ = continuous()
    pairs = ConditionalOT(weight)(x0, x1, torch.full((60, 2), 3.0), generator=seeded())
    assert cost(pairs) == pytest.approx(cost(MinibatchOT()(x0, x1)), rel=1e-6)


@pytest.mark.parametrize(
    "coupling",
    [MinibatchOT(), ConditionalOT(0.0), ConditionalOT(1e-60), AdaptiveConditionalOT(0.3)],
)
def test_equal_costs_are_not_dealt_by_the_order_of_rows(coupling):
    """Noise of two values, and data of three in which rows are sorted by c."""
    row = torch.arange(48)
    x1, c = torch.tensor([-2.0, 0.0, 2.0])[row // 16][:, None], (row % 16).float()[:, None]
    drawn = []
    for seed in range(60):
        x0 = torch.randint(2, (48, 1), generator=seeded(seed)).float() * 2 - 1
        drawn.append(coupling(x0, x1, c, generator=seeded(seed)))
    pairs = Pairs.cat(drawn)
    assert abs(np.corrcoef(pairs.x0[:, 0], pairs.c[:, 0])[0, 1]) < 0.08


def test_label_target_is_the_condition_of_x1_and_source_that_of_the_noise():
    x0, x1, c = continuous()
    target = ConditionalOT(1.0, label="target")(x0, x1, c, generator=seeded(6))
    source = ConditionalOT(1.0, label="source")(x0, x1, c, generator=seeded(6))
    assert torch.equal(target.target_index, source.target_index)  # the same pairs
    assert torch.equal(target.c, c[target.target_index])
    assert not torch.equal(target.c, source.c)
    recording = Recording(1.0)
    recording(x0, x1, c, generator=seeded(6))
    own = torch.from_numpy(recording._own)
    assert torch.equal(source.c, c[own[source.source_index]])
    assert torch.equal(source.c.sort(dim=0).values, c.sort(dim=0).values)


def test_the_condition_copy_is_new_in_each_batch():
    x0, x1, c = continuous()
    coupling, g = ConditionalOT(math.inf), seeded()
    first, second = (coupling(x0, x1, c, generator=g) for _ in range(2))
    assert not torch.equal(first.target_index, second.target_index)


def test_the_coupling_may_see_a_function_of_the_condition():
    x0, x1, c = continuous()
    halves = ConditionalOT(math.inf, condition=lambda c: (c > 0.5).float())
    pairs = halves(x0, x1, c, generator=seeded(1))
    coarse = ConditionalOT(math.inf)(x0, x1, (c > 0.5).float(), generator=seeded(1))
    assert torch.equal(pairs.target_index, coarse.target_index)
    assert torch.equal(pairs.c, c[pairs.target_index])  # the network is given c itself


def test_a_weight_too_large_for_the_solver_is_said():
    x0, x1, c = continuous()
    with pytest.warns(RuntimeWarning, match="condition_weight 1e.16 .* math.inf"):
        ConditionalOT(1e16)(x0, x1, c)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for weight in (0.0, 1e6, "balanced"):
            ConditionalOT(weight)(x0, x1, c)


def test_that_a_condition_for_each_row_leaves_no_choice_is_said():
    x0, x1, c = continuous()
    with pytest.warns(
        UserWarning, match="has a condition of its own, so that all pairs are random"
    ):
        ConditionalOT(math.inf)(x0, x1, c)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ConditionalOT(math.inf)(x0, x1, c.round())


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_even_a_huge_weight_gives_a_permutation():
    x0, x1, c = continuous(150)
    pairs = ConditionalOT(1e30)(x0, x1, c, generator=seeded())
    assert_equal_conditions_meet(pairs, c)


def test_published_parametrisations():
    assert ConditionalOT.from_gamma(10.0).condition_weight == 100
    assert ConditionalOT.from_beta(10.0, label="source").condition_weight == 100
    assert ConditionalOT.from_epsilon(0.01).condition_weight == pytest.approx(100)
    assert ConditionalOT.from_epsilon(0).condition_weight == math.inf
    assert ConditionalOT.from_beta(math.inf).condition_weight == math.inf


def seeing(condition):
    return ConditionalOT(1.0, condition=condition)(*continuous())


COT, (X0, X1, C) = ConditionalOT, continuous()
test_bad_input = refused(
    (lambda: COT(-1.0), ValueError, "condition_weight must be at least 0"),
    (lambda: COT(math.nan), ValueError, "condition_weight must be at least 0"),
    (lambda: COT(-math.inf), ValueError, "condition_weight must be at least 0"),
    (
        lambda: COT("auto"),
        ValueError,
        "condition_weight must be a number .*, or one of scaled, balanced;",
    ),
    (lambda: COT(None), TypeError, "condition_weight must be a number"),
    (lambda: COT(torch.ones(2)), TypeError, "condition_weight must be a number"),
    (lambda: COT(1e308)(X0, X1, 100 * C), ValueError, r"condition_weight 1e.308 .* infinite"),
    (lambda: COT.from_gamma(-1), ValueError, "gamma must be at least 0"),
    (lambda: COT(label="both"), ValueError, "label must be one of target, source; got 'both'"),
    (lambda: COT()(X0, X1), TypeError, "ConditionalOT needs the conditions c of x1, got None"),
    (lambda: seeing(3), TypeError, "condition must be a function"),
    (lambda: seeing(lambda c: None), TypeError, r"condition\(c\) must be a torch tensor"),
    (lambda: seeing(lambda c: c[:30]), ValueError, r"condition\(c\) has 30 rows, c has 60"),
)


def weighing(value):
    class Own(ConditionalOT):
        def weight(self, sample_cost, condition_cost, noise_condition_index):
            return value

    x = torch.randn(8, 2, generator=seeded())
    return lambda: Own()(x, x, x)


test_a_weight_of_one_s_own_is_looked_at = refused(
    (weighing(-1.0), ValueError, r"weight\(...\) must be at least 0 and finite, got -1"),
    (weighing(math.nan), ValueError, r"weight\(...\) must be at least 0"),
    (weighing(None), TypeError, r"weight\(...\) must be a number, got None"),
    (weighing("x"), TypeError, r"weight\(...\) must be a number, got 'x'"),
)


@pytest.mark.filterwarnings("ignore:column 1 of c is hardly heeded")
@pytest.mark.parametrize("base", ["balanced", 0.0, 100.0, math.inf])
def test_a_weight_of_one_s_own_is_obeyed_whatever_the_option_is(base):
    """A number in the option won, and `candidates` said otherwise."""

    class Annealed(ConditionalOT):
        now = 0.0

        def weight(self, sample_cost, condition_cost, noise_condition_index):
            return self.now

    x0, x1, c = (torch.randn(64, 2, generator=seeded(k)) for k in range(3))
    own = Annealed(base)
    for own.now in (0.0, 3.0):
        pairs, known = (coupling(x0, x1, c, seeded(4)) for coupling in (own, COT(own.now)))
        assert torch.equal(pairs.target_index, known.target_index)
        assert own.candidates(x0, x1, c) == COT(own.now).candidates(x0, x1, c)


@pytest.mark.parametrize("layer", [torch.nn.Dropout(0.1), torch.nn.BatchNorm1d(3)])
@pytest.mark.parametrize("kind", [ConditionalOT, AdaptiveConditionalOT])
def test_an_encoder_that_trains_is_refused(kind, layer):
    """A batch moved its running mean, and dropout cost most of what pairs gain."""
    encoder = torch.nn.Sequential(torch.nn.Linear(3, 3), layer)
    x0, x1, c = torch.randn(3, 64, 3, generator=seeded())
    coupling = kind(condition=encoder.train())
    for call in (coupling, coupling.candidates):
        with pytest.raises(ValueError, match="condition must be in eval mode"):
            call(x0, x1, c)
    encoder.eval()
    state = {name: value.clone() for name, value in encoder.state_dict().items()}
    assert len(coupling(x0, x1, c)) == 64
    assert all(torch.equal(state[name], value) for name, value in encoder.state_dict().items())
