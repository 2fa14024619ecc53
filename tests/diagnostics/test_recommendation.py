"""What is recommended, and that it is never a skewed coupling."""

import importlib
import math
from dataclasses import replace

import pytest
import torch
from support import refused, seeded

from cotlearn import mixtures
from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier, recommend, skew
from cotlearn.diagnostics.probe import one_step_scores, regression_scores
from cotlearn.diagnostics.recommendation import _choose, beyond_chance, gain_over
from cotlearn.flows import VelocityMLP, fit

FRONTIER = importlib.import_module("cotlearn.diagnostics.frontier")
SPREAD = importlib.import_module("cotlearn.diagnostics.spread")
ONE_STEP_ERROR = FRONTIER.one_step_error


@pytest.fixture(scope="module", autouse=True)
def quick():
    """What takes the time and decides nothing here, the least of it: see `test_frontier.py`.

    99 relabellings are the least that can flag at .01; no advice looks at the one-step error or at
    the interval of the one-step variance. The spread has 400 rows but where it decides.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SPREAD, "MOST_ROWS", 400)
        patch.setattr(skew, "RELABELLINGS", 99)
        patch.setattr(FRONTIER, "RESAMPLES", 2)
        patch.setattr(FRONTIER, "one_step_error", lambda *_: 0.0)
        yield


def advice(x1, c, **options):
    return recommend(x1, c, **{"rows": 512, "probe_steps": 60, "progress": False, **options})


@pytest.mark.slow
@pytest.mark.parametrize("name", ["petals", "rotating_pair", "moving_modes"])
def test_several_modes_within_conditions_call_for_a_conditional_coupling(name):
    x1, c = getattr(mixtures, name)().sample(800, generator=seeded())
    chosen = advice(x1, c)
    assert isinstance(chosen.coupling, ConditionalOT | StratifiedOT)
    assert not chosen.frontier[chosen.name].flagged
    assert chosen.frontier["naive OT"].flagged
    independent = chosen.frontier["independent"]
    assert chosen.frontier[chosen.name].one_step_score < 0.95 * independent.one_step_score
    assert f"Use {chosen.name}" in chosen.reason
    alike = ", ".join(chosen.within_chance)
    assert (f"Within chance of it: {alike}." if alike else "score worse.") in chosen.reason
    assert "\n" not in chosen.reason  # one paragraph


@pytest.mark.slow
def test_one_mode_for_each_condition_needs_no_coupling():
    """x1 = f(c) and a little noise: a regression would do."""
    c = torch.rand(800, 1, generator=seeded())
    x1 = torch.cat([torch.sin(4 * c), c], dim=1) + 0.01 * torch.randn(800, 2, generator=seeded(1))
    chosen = advice(x1, c)
    assert isinstance(chosen.coupling, Independent)
    assert chosen.regression_wins
    assert "anything to straighten" in chosen.reason
    assert chosen.spread.between_share > 0.98


@pytest.mark.slow
def test_a_thin_circle_has_nothing_to_straighten():
    """Its thickness is learnt by all, so that a regression does not win, and yet it would do."""
    angle = 2 * math.pi * torch.rand(2000, 1, generator=seeded())
    place = torch.cat([angle.cos(), angle.sin()], dim=1)
    circle = 3 * place + 0.05 * torch.randn(2000, 2, generator=seeded(1))
    chosen = advice(circle, place, probe_steps=100)
    assert chosen.name == "independent"
    assert "anything to straighten" in chosen.reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_three_columns_that_all_but_determine_the_data_call_for_a_regression(seed):
    """.2 % of the variance within: neighbours saw 7 %, and the advice was more data."""
    g = seeded(seed)
    c = torch.randn(1000, 3, generator=g)
    plane = torch.stack([(c[:, 0] + c[:, 1]).sin() + c[:, 2], c[:, 0] - c[:, 2].tanh()], dim=1)
    noise = math.sqrt(0.002 * plane.var(dim=0).mean())
    chosen = advice(plane + noise * torch.randn(1000, 2, generator=g), c, seed=seed)
    assert chosen.regression_wins
    assert "Use a regression" in chosen.reason
    assert "More data" not in chosen.reason
    assert chosen.spread.between_share > 0.96


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_coupling_must_beat_independent_pairs_by_more_than_chance(seed):
    """Data with nothing to straighten: what is picked all the same must have earned it."""
    c = torch.randn(400, 5, generator=seeded(seed))
    chosen = advice(3 * c + 0.01 * torch.randn(400, 5, generator=seeded(10 + seed)), c)
    free = chosen.frontier["independent"]
    if chosen.regression_wins:
        assert chosen.regression_score < 0.99 * free.one_step_score
    elif isinstance(chosen.coupling, Independent):
        assert "Use independent pairs" in chosen.reason
        assert "reflow" in chosen.reason
        for point in chosen.frontier:
            gain, error = gain_over(point, free)
            assert point.flagged or gain <= max(3 * error, 0.01 * free.one_step_score)
    else:
        gain, error = gain_over(chosen.frontier[chosen.name], free)
        assert gain > max(2.2 * error, 0.01 * free.one_step_score)


def test_the_best_of_many_is_ahead_by_luck_as_often_as_the_only_one():
    """Scores without any difference: 4,000 trials with 10 candidates, and with one."""
    x1, c = mixtures.petals().sample(300, generator=seeded())
    found = frontier(x1, c, {"a": Independent()}, rows=100, batch_size=50, progress=False)
    rows = 60
    for candidates in (1, 10):
        scores = torch.randn(4000, candidates, rows, generator=seeded(candidates))
        ahead = scores.mean(dim=2) / (scores.std(dim=2) / rows**0.5)
        point = replace(found["a"], scores=scores[0, 0])
        lucky = (ahead.max(dim=1).values > beyond_chance(point, of=candidates)).float().mean()
        assert 0.015 < lucky < 0.035


@pytest.mark.slow
def test_it_is_said_when_the_condition_explains_a_part_of_the_noise():
    """Few strata: x0 within one follows x1, which follows c."""
    c = torch.rand(2000, 1, generator=seeded())
    x1 = 2 * c + torch.randn(2000, 1, generator=seeded(1)).sign() + 0.1 * c.square()
    chosen = advice(x1, c, rows=1024)
    linear = chosen.frontier[chosen.name].linear_skew
    assert linear is not None
    assert ("A regression on the condition explains" in chosen.reason) == linear.flagged
    assert chosen.frontier["naive OT"].linear_skew.flagged
    assert not chosen.frontier["independent"].linear_skew.flagged


@pytest.mark.slow
def test_in_many_dimensions_the_probe_sees_what_neighbours_cannot(monkeypatch):
    """Two modes in 30 columns of noise."""
    monkeypatch.setattr(FRONTIER, "one_step_error", ONE_STEP_ERROR)
    sign = (2 * torch.randint(2, (1200, 1), generator=seeded()) - 1).float()
    x1 = torch.randn(1200, 30, generator=seeded(1))
    x1[:, :3] = 3 * sign + 0.3 * x1[:, :3]
    c = torch.eye(2)[torch.randint(2, (1200,), generator=seeded(2))]
    found = advice(x1, c, probe_steps=200).frontier
    share = found["COT per label"].one_step_error / found["independent"].one_step_error
    assert share > 0.8  # the rule that this one replaced would have found no gain
    gain, error = gain_over(found["COT per label"], found["independent"])
    assert gain > 3 * error


@pytest.mark.slow
def test_a_condition_that_says_nothing_leaves_naive_ot_harmless():
    """Then x0 cannot depend on c, and nobody should be warned of skew."""
    x1, _ = mixtures.petals().sample(1000, generator=seeded())
    c = torch.eye(2)[torch.randint(2, (1000,), generator=seeded(1))]
    chosen = advice(x1, c)
    assert not chosen.frontier["naive OT"].flagged
    assert not isinstance(chosen.coupling, Independent)
    assert "does not visibly skew" in chosen.reason


@pytest.mark.slow
def test_constant_conditions():
    x1, _ = mixtures.petals().sample(800, generator=seeded())
    chosen = advice(x1, torch.full((800, 1), 0.1), rows=256)
    found = chosen.frontier[chosen.name]
    assert not found.flagged
    assert found.one_step_score < chosen.frontier["independent"].one_step_score
    assert chosen.coupling == MinibatchOT()  # before, COT per label
    assert [point.name for point in chosen.frontier] == ["independent", "naive OT"]
    assert chosen.reason.startswith("The condition does not vary")
    assert "label" not in chosen.reason


@pytest.mark.slow
def test_it_is_said_which_others_are_as_good():
    x1, c = mixtures.petals().sample(400, generator=seeded())
    found = advice(x1, c, rows=256, probe_steps=10)
    clean = [p.name for p in found.frontier if not p.flagged and p.name != "independent"]
    assert len(clean) > 1
    wave = 0.1 * torch.linspace(-1.5, 1.5, 100)
    for second, words in ((0.9, "All others without significant skew score worse"),
                          (0.5, "Within chance of it: ")):  # fmt: skip
        mean = {"independent": 1.0} | dict.fromkeys(clean, second) | {clean[0]: 0.49}
        points = (
            replace(p, scores=mean.get(p.name, 1.0) + wave * (-1) ** i)
            for i, p in enumerate(found.frontier)
        )
        given = replace(found.frontier, points=tuple(points)), found.spread, torch.ones(100)
        point, wins, reason = _choose(*given)
        assert not wins
        assert point.name == clean[0]
        assert words in reason


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_skewed_coupling_is_never_picked(seed):
    """Small noisy data of all sorts."""
    g = seeded(seed)
    c = torch.randn(400, 2, generator=g)
    x1 = seed * c + torch.randn(400, 2, generator=g).sign() + 0.2 * torch.randn(400, 2, generator=g)
    chosen = advice(x1, c, batch_size=128, seed=seed)
    if not isinstance(chosen.coupling, Independent):
        assert not chosen.frontier[chosen.name].flagged


@pytest.mark.slow
def test_what_is_recommended_trains():
    data = mixtures.petals()
    chosen = advice(*data.sample(400, generator=seeded()), rows=256, probe_steps=10)
    assert isinstance(chosen.coupling, Coupling)
    if isinstance(chosen.coupling, StratifiedOT):
        chosen.coupling.n_samples = 256
    result = fit(VelocityMLP(2, 4, width=8, depth=1, seed=0), data, chosen.coupling, steps=3,
                 batch_size=64, progress=False)  # fmt: skip
    assert len(result.history["loss"]) == 1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_advice():
    x1, c = mixtures.rotating_pair().sample(200, generator=seeded())
    one, two = (advice(x1, c, rows=256, probe_steps=10, seed=4) for _ in range(2))
    assert (one.name, one.reason, one.spread) == (two.name, two.reason, two.spread)


X, C = torch.randn(220, 2), torch.randn(220, 1)


test_bad_input = refused(
    (lambda: recommend(X[:99], C[:99]), ValueError, "x1 needs at least 100 rows"),
    (lambda: recommend(X, C[:9]), ValueError, "c has 9 rows, x1 has 220"),
    (lambda: recommend(X, C[:, 0]), ValueError, "c must have shape"),
    (lambda: recommend(X / 0, C), ValueError, "x1 has NaN"),
    (lambda: recommend([0.0], C), TypeError, "x1 must be a torch tensor"),
    (lambda: recommend(X, C, batch_size=1), ValueError, "batch_size must be at least 2"),
    (lambda: recommend(X, C, probe_steps=0), ValueError, "probe_steps must be at least 1"),
)


def test_of_many_rows_a_sample_is_compared(monkeypatch):
    """10^5 rows took 150 seconds; clusters are counted for all rows, with as many in each."""
    recommendation = importlib.import_module("cotlearn.diagnostics.recommendation")
    seen = []

    def looks(x1, c, couplings, **options):
        seen.append((len(x1), couplings))
        raise InterruptedError

    monkeypatch.setattr(recommendation, "MOST_ROWS", 400)
    monkeypatch.setattr(recommendation, "frontier", looks)
    x1, c = mixtures.moving_modes().sample(1600, generator=seeded())
    with pytest.raises(InterruptedError):
        recommend(x1, c)
    rows, couplings = seen[0]
    assert rows == 400
    assert couplings["stratified, 32 rows"].clusters.clusters == 400 * 3 // 4 // 32
    assert recommendation.candidates(x1, c)["stratified, 32 rows"].clusters.clusters == 37


@pytest.mark.slow
def test_a_regression_is_scored_on_the_rows_of_the_probe():
    """A probe that predicts what the regression predicts would have the same scores."""
    x1, c = mixtures.rotating_pair().sample(300, generator=seeded())
    train, test = FRONTIER.held_out(x1, c, 3)
    far = Dataset(test.x1 + 1e4 * torch.arange(len(test))[:, None], test.c)  # each row tells itself
    pairs = Independent()(torch.randn_like(train.x1), train.x1, train.c)
    probe = one_step_scores(pairs, far, steps=3, seed=3)
    alone = regression_scores(train, far, steps=3, seed=3)
    assert (probe.argsort() == alone.argsort()).all()
