"""MAC against the pair error computed one pair at a time."""

import math

import numpy as np
import ot
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from support import Still, joined, refused, seeded, take
from torch import nn

from cotlearn import mixtures
from cotlearn.couplings import MinibatchOT, ModelAligned, aligned
from cotlearn.couplings.assignment import sinkhorn_plan
from cotlearn.couplings.distances import squared_distances
from cotlearn.diagnostics import prior_skew
from cotlearn.flows import VelocityMLP, fit


class Counted(nn.Module):
    """A random network that remembers what it was asked."""

    def __init__(self, condition_dim=3, scale=3.0):
        super().__init__()
        self.inner = VelocityMLP(2, condition_dim, width=16, depth=2, seed=1)
        self.scale, self.rows, self.times = scale, 0, []

    def forward(self, t, x, c=None):
        self.rows += len(x)
        self.times.append(float(t))
        assert not torch.is_grad_enabled()
        return self.scale * self.inner(t, x, c)


def batch(n=20, classes=3, seed=0):
    g = seeded(seed)
    c = torch.eye(classes)[torch.randint(classes, (n,), generator=g)]
    return torch.randn(n, 2, generator=g), 2 * torch.randn(n, 2, generator=g), c


def looking_at(network, variant, step=0, **options):
    coupling = ModelAligned(variant, **{"warmup_steps": 0, **options})
    coupling.observe(network, step)
    return coupling


@torch.no_grad()
def pair_error(network, x0, x1, c):
    """The definition, for one pair: |v(t, x_t, c) - (x1 - x0)|^2, mean over t = 0 and t = 1."""
    label = None if c is None else c[None]
    at_start = network(torch.tensor(0.0), x0[None], label)[0]
    at_end = network(torch.tensor(1.0), x1[None], label)[0]
    return sum(float(((v - (x1 - x0)) ** 2).sum()) for v in (at_start, at_end)) / 2


def all_errors(network, x0, x1, c):
    """M_ij with x0 of i, and x1 and label of j."""
    ends = list(zip(x1, [None] * len(x1) if c is None else c, strict=True))
    return np.array([[pair_error(network, start, *end) for end in ends] for start in x0])


@pytest.mark.parametrize("labels", ["classes", "all different", "none"])
def test_the_matrix_is_the_error_of_each_pair(labels):
    x0, x1, c = batch()
    if labels == "all different":
        c = torch.randn(20, 3, generator=seeded(7))
    c = None if labels == "none" else c
    network = Counted(0 if c is None else 3)
    coupling = looking_at(network, "full")
    with torch.no_grad():
        found = coupling.errors(x0, x1, c)
    np.testing.assert_allclose(found, all_errors(network, x0, x1, c), rtol=1e-4, atol=1e-4)


def test_the_errors_of_rows_are_the_diagonal():
    x0, x1, c = batch()
    network = Counted()
    coupling = looking_at(network, "weighted")
    with torch.no_grad():
        rows = coupling.row_errors(x0, x1, c)
    np.testing.assert_allclose(rows, all_errors(network, x0, x1, c).diagonal(), rtol=1e-4)
    assert set(network.times) == {0.0, 1.0}


@pytest.mark.parametrize(
    ("variant", "classes", "expected"),
    [("weighted", 3, 40), ("topk", 3, 40), ("full", 3, 20 * 4), ("full", 0, 20 * 21)],
)
def test_evaluations_are_counted(variant, classes, expected):
    x0, x1, c = batch()
    c = c if classes else torch.randn(20, 3)
    network = Counted()
    coupling = looking_at(network, variant)
    coupling(x0, x1, c)
    assert coupling.evaluations == network.rows == expected


@pytest.mark.filterwarnings("error")
def test_full_without_a_condition_needs_two_evaluations_a_row():
    x0, x1, _ = batch(200)  # and no limit of 64 rows
    coupling = looking_at(Counted(0), "full")
    assert len(coupling(x0, x1)) == 200
    assert coupling.evaluations == 400


def test_full_with_a_zero_network_is_minibatch_ot():
    x0, x1, c = batch(30)
    coupling = looking_at(Still(), "full", regularization=(0.01, 0.01))
    with torch.no_grad():
        M = coupling.errors(x0, x1, c)
    np.testing.assert_allclose(M, squared_distances(x0, x1), rtol=1e-5)
    plain = MinibatchOT()(x0, x1, c).target_index
    assert np.array_equal(linear_sum_assignment(M)[1], plain)
    pairs = coupling(x0, x1, c)  # and through Sinkhorn, up to near ties
    rows = np.arange(30)
    assert M[rows, pairs.target_index].sum() == pytest.approx(M[rows, plain].sum(), rel=0.01)
    assert pairs.weight is None


@pytest.mark.slow
def test_full_with_little_regularisation_is_the_assignment_on_the_errors():
    x0, x1, c = batch(30)
    network = Counted()
    M = all_errors(network, x0, x1, c)
    sharp = looking_at(network, "full", regularization=(0.01, 0.01))(x0, x1, c)
    best = M[linear_sum_assignment(M)].sum()
    assert M[np.arange(30), sharp.target_index].sum() == pytest.approx(best, rel=1e-3)
    assert torch.equal(sharp.target_index.sort().values, torch.arange(30))
    assert torch.equal(sharp.c, c[sharp.target_index])


@pytest.mark.parametrize(
    ("step", "expected"), [(0, 2.0), (25, 1.55), (50, 1.1), (100, 0.2), (9999, 0.2)]
)
def test_regularisation_falls_over_the_warm_up(step, expected, monkeypatch):
    """In units of the standardised cost, whatever units `sinkhorn_plan` has."""
    used = []

    def watched(cost, *, regularization):
        used.append((cost.std(), regularization * cost.mean()))
        return sinkhorn_plan(cost, regularization=regularization)

    monkeypatch.setattr(aligned, "sinkhorn_plan", watched)
    looking_at(Counted(), "full", step, warmup_steps=100)(*batch())
    assert used == [(pytest.approx(1), pytest.approx(expected))]


def test_full_maximises_the_sum_of_plan_entries():
    """The permutation is that of P and not of log P, on which Sinkhorn would change nothing."""
    x0, x1, c = batch(40)
    network = Counted()
    M = all_errors(network, x0, x1, c)
    plan = ot.sinkhorn(np.full(40, 1 / 40), np.full(40, 1 / 40), (M - M.mean()) / M.std(), 0.2,
                       method="sinkhorn_log", numItermax=5000)  # fmt: skip
    pairs = looking_at(network, "full", regularization=(0.2, 0.2))(x0, x1, c)
    best = plan[linear_sum_assignment(plan, maximize=True)].sum()
    assert plan[np.arange(40), pairs.target_index].sum() == pytest.approx(best, rel=1e-3)


def test_scale_of_the_data_does_not_matter_to_full():
    x0, x1, c = batch(30)
    one = looking_at(Still(), "full")(x0, x1, c)
    hundred = looking_at(Still(), "full")(100 * x0, 100 * x1, c)
    assert torch.equal(one.target_index, hundred.target_index)


@pytest.mark.parametrize("boost", [0.5, 1.0, 0.0])
@pytest.mark.parametrize(("n", "fraction"), [(20, 0.4), (33, 0.4), (10, 0.2), (7, 0.5), (20, 1.0)])
def test_weighted_boosts_the_easiest_pairs(n, fraction, boost):
    x0, x1, c = batch(n)
    network = Counted()
    pairs = looking_at(network, "weighted", fraction=fraction, boost=boost)(x0, x1, c)
    assert torch.equal(pairs.x0, x0)
    assert torch.equal(pairs.x1, x1)  # random pairs stay random pairs
    assert pairs.weight.mean() == pytest.approx(1, rel=1e-5)
    chosen = round(100 * fraction) * n // 100  # floor(B p) in whole numbers
    errors = all_errors(network, x0, x1, c).diagonal()
    expected = np.ones(n)
    expected[errors.argsort()[:chosen]] += boost
    np.testing.assert_allclose(pairs.weight, expected / expected.mean(), rtol=1e-5)


def test_floor_is_exact_for_every_percentage():
    coupling = ModelAligned("topk", warmup_steps=0)
    x0 = x1 = torch.randn(100, 1)
    coupling.observe(Still(), 0)
    for percent in range(1, 101):
        coupling.fraction = percent / 100
        assert int((coupling(x0, x1).weight > 0).sum()) == percent


def test_topk_trains_on_the_selected_share_only():
    x0, x1, c = batch(33)
    network = Counted()
    pairs = looking_at(network, "topk", fraction=0.4)(x0, x1, c)
    errors = all_errors(network, x0, x1, c).diagonal()
    expected = np.zeros(33)
    expected[errors.argsort()[:13]] = 33 / 13
    np.testing.assert_allclose(pairs.weight, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("step", "share"), [(0, 1.0), (250, 0.85), (500, 0.7), (1000, 0.4), (9999, 0.4)]
)
def test_the_share_falls_linearly_over_the_warm_up(step, share):
    coupling = looking_at(Still(), "topk", step, warmup_steps=1000, fraction=0.4)
    assert int((coupling(*batch(200)).weight > 0).sum()) == int(200 * share + 1e-6)


def test_one_row_is_always_left():
    pairs = looking_at(Still(), "topk", fraction=0.01)(*batch(5))
    assert pairs.weight.tolist().count(5.0) == 1


def test_full_is_skewed_and_the_condition_weight_mends_it():
    data = mixtures.petals()
    skew = []
    for weight in (0.0, 1e3):
        parts = []
        for seed in range(10):
            x1, c = data.sample(64, generator=seeded(seed))
            coupling = looking_at(Still(), "full", condition_weight=weight)
            parts.append(coupling(torch.randn(64, 2, generator=seeded(100 + seed)), x1, c))
        skew.append(prior_skew(joined(parts, "x0"), joined(parts, "c"), generator=seeded()))
    assert skew[0].flagged
    assert not skew[1].flagged


def test_a_large_condition_weight_pairs_within_labels():
    x0, x1, c = batch(40)
    pairs = looking_at(Counted(), "full", condition_weight=1e4)(x0, x1, c)
    assert torch.equal(pairs.c, c[pairs.source_index])
    assert not torch.equal(pairs.target_index, pairs.source_index)


def test_candidates():
    x0, x1, c = batch(40)
    assert ModelAligned("weighted").candidates(x0, x1, c) == 1
    assert ModelAligned("full").candidates(x0, x1, c) == 40
    labels = (c[:, None] == c[None]).all(dim=2).double().sum(dim=1).mean()
    heavy = ModelAligned("full", condition_weight=1e4)
    assert heavy.candidates(x0, x1, c) == pytest.approx(float(labels))


def test_more_than_64_distinct_conditions_are_refused():
    x0, x1, _ = batch(65)
    c = torch.randn(65, 3)
    coupling = looking_at(Counted(), "full")
    with pytest.raises(ValueError, match=r"65 different conditions.*64.*ot_batch_size"):
        coupling(x0, x1, c)
    coupling(x0[:64], x1[:64], c[:64])
    looking_at(Counted(), "weighted")(x0, x1, c)


def test_equal_errors_and_equal_rows():
    x0 = torch.zeros(6, 2)
    pairs = looking_at(Still(), "full")(x0, x0 + 1)
    assert torch.equal(pairs.target_index, torch.arange(6))
    assert looking_at(Still(), "full")(x0[:1], x0[:1]).target_index.tolist() == [0]


@pytest.mark.parametrize("dtype", [torch.int64, torch.bool])
@pytest.mark.parametrize("variant", ["weighted", "topk", "full"])
def test_integer_and_bool_conditions(variant, dtype):
    x0, x1, c = batch()
    options = {"condition_weight": 2.0} if variant == "full" else {}
    expected = looking_at(Counted(), variant, **options)(x0, x1, c)
    pairs = looking_at(Counted(), variant, **options)(x0, x1, c.to(dtype))
    assert torch.equal(pairs.target_index, expected.target_index)


@pytest.mark.parametrize("variant", ["weighted", "topk", "full"])
def test_training_shows_it_the_averaged_network(variant):
    seen = []

    class Watched(ModelAligned):
        def observe(self, network, step):
            seen.append((network, step))
            super().observe(network, step)

    network = VelocityMLP(2, 4, width=8, depth=1, seed=0)
    result = fit(network, mixtures.petals(), Watched(variant, warmup_steps=3), steps=5,
                 batch_size=16, progress=False)  # fmt: skip
    assert [step for _, step in seen] == list(range(5))
    assert all(shown is result.network for shown, _ in seen)  # the EMA copy
    assert np.isfinite(result.history["loss"]).all()


def test_a_stream_weighs_every_part_of_an_ot_batch():
    coupling = looking_at(Counted(4), "weighted")
    parts = take(coupling, mixtures.petals(), 4, batch_size=8, ot_batch_size=32)
    assert joined(parts, "weight").mean() == pytest.approx(1, rel=1e-5)


def test_what_it_says_of_itself():
    coupling = ModelAligned("full", condition_weight=2.0)
    assert (coupling.name, coupling.traits.needs_network) == ("aligned", True)
    before = repr(coupling)
    coupling.observe(Still(), 3)
    coupling(*batch())
    assert repr(coupling) == before  # a resumed training compares it


B, HEAVY = batch(), looking_at(Still(), "full", condition_weight=1.0)
test_bad_input = refused(
    (lambda: ModelAligned("hard"), ValueError, "variant must be one of weighted, topk, full"),
    (lambda: ModelAligned(fraction=0.0), ValueError, "fraction must be above 0"),
    (lambda: ModelAligned(fraction=1.1), ValueError, "fraction must lie in"),
    (lambda: ModelAligned(fraction=math.nan), ValueError, "fraction"),
    (lambda: ModelAligned(fraction="some"), TypeError, "fraction must be a number"),
    (lambda: ModelAligned(boost=-0.5), ValueError, "boost must be at least 0"),
    (lambda: ModelAligned(warmup_steps=-1), ValueError, "warmup_steps must be at least 0"),
    (lambda: ModelAligned(regularization=(2.0, 0.0)), ValueError, "regularization must be ab"),
    (lambda: ModelAligned(regularization=0.2), ValueError, "regularization must have shape"),
    (lambda: ModelAligned(condition_weight=1.0), ValueError, "condition_weight is for variant"),
    (lambda: ModelAligned("full", condition_weight=math.inf), ValueError, "condition_weight"),
    (lambda: ModelAligned()(*B), ValueError, "no network yet: call observe"),
    (lambda: HEAVY(*B[:2]), TypeError, "needs the conditions c"),
)


def test_a_network_that_trains_with_dropout_is_refused():
    network = torch.nn.Sequential(torch.nn.Linear(2, 2), torch.nn.BatchNorm1d(2))
    ModelAligned().observe(network.eval(), 0)
    with pytest.raises(ValueError, match="network must be in eval mode"):
        ModelAligned().observe(network.train(), 0)


@pytest.mark.parametrize(("name", "value"), [("variant", "Full"), ("fraction", 40)])
def test_options_that_are_set_later_are_checked(name, value):
    coupling = ModelAligned("topk", warmup_steps=0)
    coupling.observe(torch.nn.Linear(2, 2), 1)
    setattr(coupling, name, value)
    with pytest.raises(ValueError, match=name):
        coupling(torch.zeros(4, 2), torch.zeros(4, 2))


def test_a_network_that_somebody_trains_meanwhile_is_refused():
    network = torch.nn.Sequential(torch.nn.Linear(2, 2), torch.nn.Dropout(0.5)).eval()
    coupling = ModelAligned()
    coupling.observe(network, 0)
    network.train()
    with pytest.raises(ValueError, match="network must be in eval mode"):
        coupling(torch.zeros(4, 2), torch.zeros(4, 2))
