"""The frontier: the order of couplings that the science says, and numbers against closed forms."""

import math
import time

import numpy as np
import pytest
import torch
from support import Still, refused, seeded

from cotlearn import couplings, mixtures
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT, ModelAligned, StratifiedOT
from cotlearn.diagnostics import frontier, skew
from cotlearn.gaussian import LinearGaussian

SMALL = {"rows": 1536, "batch_size": 256, "repetitions": 2, "progress": False}


@pytest.fixture(scope="module", autouse=True)
def few_relabellings():
    """The least that can flag at .01: a test of skew is five times as quick."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(skew, "RELABELLINGS", 99)
        yield


COUPLINGS = {
    "independent": Independent(),
    "naive": MinibatchOT(),
    "COT": ConditionalOT(100.0),
    "COT, heavier": ConditionalOT(3000.0),
    "stratified": StratifiedOT(32),
}


@pytest.fixture(scope="module", params=["rotating_pair", "moving_modes"])
def found(request):
    x1, c = getattr(mixtures, request.param)().sample(1600, generator=seeded())
    return frontier(x1, c, COUPLINGS, **SMALL)


def test_only_naive_ot_is_flagged(found):
    """Also on `moving_modes`, where E[x0 | c] is zero for every c."""
    assert [point.name for point in found] == list(COUPLINGS)
    assert [point.flagged for point in found] == [False, True, False, False, False]
    assert found["naive"].skew > 0.3
    assert abs(found["independent"].skew) < 0.05


def test_conditional_couplings_lie_between(found):
    variance = {point.name: point.one_step_variance for point in found}
    assert variance["naive"] < 0.5 * variance["COT"]
    assert variance["COT"] < variance["COT, heavier"] < variance["independent"]
    assert variance["stratified"] < 0.5 * variance["independent"]
    assert found["COT"].skew < 0.2 * found["naive"].skew
    cost = {point.name: point.transport_cost for point in found}
    assert cost["naive"] < cost["COT"] < cost["COT, heavier"] < cost["independent"]


def test_candidates_fall_with_the_weight(found):
    number = [found[name].candidates for name in ("naive", "COT", "COT, heavier", "independent")]
    assert number[0] == 256
    assert number[3] == 1
    assert sorted(number, reverse=True) == number
    assert 30 < found["stratified"].candidates < 60  # 1,200 rows in 32 clusters


def test_conditional_couplings_promise_the_better_one_step_model(found):
    error = {point.name: point.one_step_error for point in found}
    assert max(error["COT"], error["stratified"]) < 0.75 * error["independent"]
    assert max(error["COT"], error["stratified"]) < error["naive"]


def test_intervals_and_seconds(found):
    for point in found:
        low, high = point.skew_interval
        assert low <= point.skew <= high
        low, high = point.one_step_variance_interval
        assert low < point.one_step_variance < high
        assert high - low < 0.3 * point.one_step_variance
        assert point.seconds > 0
        assert point.coupling == COUPLINGS[point.name].name
    assert found["independent"].seconds < found["naive"].seconds


def test_numbers_of_the_solvable_case():
    """Independent: E tr Var(x1 | x0, c) = tr S, E |x1 - x0|^2 = tr Var(x1) + d."""
    problem = LinearGaussian.example()
    x1, c = (torch.from_numpy(v).float() for v in problem.sample(3000, np.random.default_rng(0)))
    tried = {"independent": Independent(), "naive": MinibatchOT()}
    points = frontier(x1, c, tried, **{**SMALL, "rows": 2560})
    independent, naive = points["independent"], points["naive"]
    assert independent.one_step_variance == pytest.approx(np.trace(problem.S), rel=0.15)
    total = np.trace(problem.covariance[:2, :2])
    assert independent.transport_cost == pytest.approx(total + 2, rel=0.06)
    roots = np.sqrt(np.linalg.eigvalsh(problem.covariance[:2, :2]))
    assert naive.transport_cost == pytest.approx(total + 2 - 2 * roots.sum(), rel=0.25)
    assert naive.one_step_variance < 0.2  # 0 for an infinite batch


def test_one_step_error_of_a_deterministic_coupling_without_skew_is_small():
    """x1 = f(c): the mean given (x0, c) is the data, whatever the noise."""
    c = 2 * torch.rand(1200, 1, generator=seeded()) - 1
    x1 = torch.cat([c.sin(), c], dim=1)
    point = frontier(x1, c, {"independent": Independent()}, **SMALL)["independent"]
    assert point.one_step_error < 0.02
    assert point.one_step_variance < 0.02


def test_larger_batches_push_the_curve_to_the_origin():
    x1, c = mixtures.rotating_pair().sample(1600, generator=seeded())
    tried = {"COT": ConditionalOT(1000.0)}
    small, large = (frontier(x1, c, tried, **(SMALL | {"batch_size": b}))["COT"] for b in (32, 512))
    assert large.one_step_variance < 0.8 * small.one_step_variance
    assert large.candidates > 10 * small.candidates
    assert not large.flagged


def aligned(variant, **options):
    coupling = ModelAligned(variant, warmup_steps=0, **options)
    coupling.observe(Still(), 0)
    return coupling


def test_every_coupling_finds_its_place():
    x1, c = mixtures.petals().sample(300, generator=seeded())
    tried = {
        "adaptive": couplings.AdaptiveConditionalOT(0.3),
        "semidiscrete": couplings.SemidiscreteOT(50.0, iterations=50),
        "clusters": couplings.SemidiscreteOT(clusters=4, iterations=50),
        "reflow": couplings.Reflow(lambda x0, c: x0 + c[:, :2]),
        "labels": StratifiedOT(),
        **{variant: aligned(variant) for variant in ("weighted", "topk", "full")},
    }
    points = frontier(x1, c, tried, **{**SMALL, "batch_size": 64, "rows": 256})
    assert len(points) == len(tried)
    for point in points:
        numbers = point.skew, point.one_step_variance, point.one_step_error
        assert all(map(math.isfinite, numbers))
    assert points["reflow"].one_step_variance < points["labels"].one_step_variance


def test_weights_of_pairs_count():
    """Top-k of a zero network keeps the short pairs: they are not those of independent coupling."""

    x1, c = mixtures.petals().sample(600, generator=seeded())
    tried = {"independent": Independent(), "topk": aligned("topk", fraction=0.2)}
    points = frontier(x1, c, tried, **SMALL)
    assert points["topk"].transport_cost < 0.7 * points["independent"].transport_cost
    assert points["topk"].flagged  # noise near its data: p(x0 | c) is not the prior


def test_the_same_seed_gives_the_same_frontier():
    x1, c = mixtures.petals().sample(300, generator=seeded())
    options = {**SMALL, "rows": 256, "batch_size": 64}

    def numbers(seed):
        point = frontier(x1, c, {"COT": ConditionalOT(1.0)}, **options, seed=seed)["COT"]
        return point.skew, point.one_step_variance, point.one_step_error

    assert numbers(0) == numbers(0)
    assert numbers(0) != numbers(1)


@pytest.mark.parametrize("c", [torch.ones(240, 1), torch.arange(240)[:, None] % 2, "scaled"])
def test_constant_integer_and_badly_scaled_conditions(c):
    x1 = torch.randn(240, 2, generator=seeded())
    if isinstance(c, str):
        c = torch.randn(240, 2, generator=seeded(1)) * torch.tensor([1.0, 1e4])
    tried = {"i": Independent(), "n": MinibatchOT()}
    points = frontier(x1, c, tried, **{**SMALL, "batch_size": 60, "rows": 240})
    assert all(math.isfinite(p.skew) and math.isfinite(p.one_step_error) for p in points)


def test_a_data_set_smaller_than_the_batch():
    x1, c = mixtures.petals().sample(200, generator=seeded())
    points = frontier(x1, c, {"n": MinibatchOT()}, **{**SMALL, "batch_size": 1000, "rows": 300})
    assert points["n"].candidates == 150


X, C = torch.randn(220, 2), torch.randn(220, 1)
ONE = {"independent": Independent()}


test_bad_input = refused(
    (lambda: frontier(X[:99], C[:99], ONE), ValueError, "x1 needs at least 100 rows"),
    (lambda: frontier(X, C[:9], ONE), ValueError, "c has 9 rows, x1 has 220"),
    (lambda: frontier(X, C / 0, ONE), ValueError, "c has NaN"),
    (lambda: frontier(X, None, ONE), TypeError, "c must be a torch tensor"),
    (lambda: frontier(X, C, {}), ValueError, "couplings is empty"),
    (lambda: frontier(X, C, ONE, batch_size=1), ValueError, "batch_size must be at least 2"),
    (lambda: frontier(X, C, ONE, rows=1), ValueError, "rows must be at least"),
    (lambda: frontier(X, C, ONE, rows=50, batch_size=10), ValueError, "rows must be at least"),
    (lambda: frontier(X, C, ONE, repetitions=1), ValueError, "repetitions must be at least 2"),
    (lambda: frontier(X, C, ONE, **SMALL)["naive"], KeyError, "no coupling 'naive'; expect"),
)


@pytest.mark.slow
def test_seconds_of_epochs_count_the_assignments(monkeypatch):
    """Strata are solved at the first batch of an epoch; the other batches cost next to nothing."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)  # on busy machines, too
    x1, c = mixtures.rotating_pair().sample(4000, generator=seeded())
    tried = {"strata": StratifiedOT(3), "independent": Independent()}
    points = frontier(x1, c, tried, rows=256, batch_size=128, repetitions=2)
    assert points["strata"].seconds > 5 * points["independent"].seconds
