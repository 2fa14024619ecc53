"""The metrics against formulas computed another way."""

import math

import numpy as np
import ot
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from support import refused, seeded

from cotlearn import metrics
from cotlearn.datasets import Dataset
from cotlearn.flows import integrate
from cotlearn.gaussian import LinearGaussian, bures_squared
from cotlearn.metrics import (
    bootstrap_interval,
    conditional_squared_w2,
    energy_distance,
    energy_score,
    energy_scores,
    joint_squared_w2,
    l2_uvp,
    mode_entropy,
    paired_bootstrap,
    squared_w2,
    straightness,
    wilson_interval,
)
from cotlearn.mixtures import moving_modes, petals


def normal(n, d=2, seed=0, shift=0.0):
    return torch.randn(n, d, generator=seeded(seed), dtype=torch.float64) + shift


# --- squared W2 ---


@pytest.mark.parametrize("n", [1, 2, 50, 300])
def test_one_dimension_is_the_sorted_formula(n):
    a, b = normal(n, 1), 2 * normal(n, 1, seed=1) + 1
    expected = (a.sort(dim=0).values - b.sort(dim=0).values).square().mean()
    assert squared_w2(a, b) == pytest.approx(float(expected))


def test_different_sizes_by_repeating_rows():
    a, b = normal(20), normal(30, seed=1)
    assert squared_w2(a, b) == pytest.approx(squared_w2(a.repeat(3, 1), b.repeat(2, 1)))
    assert squared_w2(a, b) == pytest.approx(squared_w2(b, a))


@pytest.mark.parametrize("n", [2, 64, 300])
def test_linear_program_of_pot(n):
    a, b = normal(n, 3), normal(n, 3, seed=1)
    weights = np.full(n, 1 / n)
    expected = ot.emd2(weights, weights, cdist(a, b, "sqeuclidean"))
    assert squared_w2(a, b) == pytest.approx(expected)


def test_a_shift_costs_its_square():
    a = normal(40)
    assert squared_w2(a, a + torch.tensor([3.0, -4.0])) == pytest.approx(25)
    assert squared_w2(a, a[torch.randperm(40)]) == pytest.approx(0, abs=1e-12)


def test_gaussians_by_bures():
    """Quantiles on a grid in one dimension, a large sample in two."""
    levels = (torch.arange(1000, dtype=torch.float64) + 0.5) / 1000
    quantiles = math.sqrt(2) * torch.erfinv(2 * levels - 1)[:, None]
    assert squared_w2(2 * quantiles, 3 * quantiles + 1) == pytest.approx(2, abs=0.01)
    S = LinearGaussian.example().S
    root = torch.from_numpy(np.linalg.cholesky(S))
    a, b = normal(1500), normal(1500, seed=1) @ root.T
    assert squared_w2(a, b) == pytest.approx(bures_squared(np.eye(2), S), abs=0.1)


def test_float32_and_float64_agree():
    a, b = normal(50), normal(50, seed=1)
    assert squared_w2(a.float(), b.float()) == pytest.approx(squared_w2(a, b), rel=1e-5)


# --- conditional squared W2 ---


def test_conditional_squared_w2_averages_over_conditions():
    """A sampler that is off by k in condition k; the shift adds its square to the floor."""
    data = petals(n_conditions=3)

    def shifted(c, generator=None):
        off = c.argmax(dim=1, keepdim=True).float()
        return data.sample_given(c, generator=generator) + off

    floor = conditional_squared_w2(data.sample_given, data, n=300, generator=seeded())
    value = conditional_squared_w2(shifted, data, n=300, generator=seeded())
    assert 0 < floor < 0.2
    expected = np.mean([2 * k**2 for k in range(3)])
    assert value == pytest.approx(expected, abs=0.4)


def test_conditional_squared_w2_asks_for_every_condition():
    data, seen = moving_modes(), []

    def sample(c, generator=None):
        seen.append(c)
        return data.sample_given(c, generator=generator)

    conditional_squared_w2(sample, data, n=10)
    assert [c.shape for c in seen] == [(10, 1)] * 9


# --- straightness ---


def test_straightness_of_a_straight_field_is_zero():
    x0 = normal(10)
    assert straightness(lambda t, x, c: torch.ones_like(x), x0) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
def test_straightness_far_from_0_in_few_digits(dtype):
    def field(t, x, c):
        return 3 * torch.sin(2 * torch.pi * t) * torch.ones_like(x)

    x0 = (100 + torch.randn(20, 2, generator=seeded())).to(dtype)
    assert straightness(field, x0) == pytest.approx(9, rel=0.01)


def test_straightness_needs_a_finite_field():
    with pytest.raises(ValueError, match="velocity must be finite along its own paths"):
        straightness(lambda t, x, c: x / 0, normal(5))


@pytest.mark.parametrize("scale", [1e-170, 1e160])
def test_scores_of_numbers_whose_squares_float64_does_not_hold(scale):
    a, b = scale * torch.randn(2, 30, 2, dtype=torch.float64, generator=seeded())
    with pytest.raises(ValueError, match="whose squares float64 holds"):
        metrics.energy_score(torch.stack([a, b]), a)
    with pytest.raises(ValueError, match="whose squares float64 holds"):
        metrics.joint_squared_w2(a / scale, b / scale, a)


def test_straightness_of_a_known_field():
    """v = (2 t, 0): the path is t^2, and int (2 t - 1)^2 dt = 1/3."""

    def velocity(t, x, c):
        return torch.stack([2 * t.expand(len(x)), torch.zeros(len(x))], dim=1).to(x)

    assert straightness(velocity, normal(5)) == pytest.approx(1 / 3, rel=1e-3)


def test_optimal_paths_are_straighter_than_independent_ones():
    problem = LinearGaussian.example()

    def field(flow):
        return lambda t, x, c: torch.from_numpy(flow.velocity(float(t), x.numpy(), c.numpy()))

    x0, c = normal(200), normal(200, 1, seed=1)
    independent = straightness(field(problem.flow("independent")), x0, c)
    assert straightness(field(problem.flow(math.inf)), x0, c) == pytest.approx(0, abs=1e-9)
    assert independent > 0.01


def test_straightness_zero_means_one_step_is_exact():
    flow = LinearGaussian.example().flow(math.inf)

    def velocity(t, x, c):
        return torch.from_numpy(flow.velocity(float(t), x.numpy(), c.numpy()))

    x0, c = normal(20), normal(20, 1, seed=1)
    one, many = (integrate(velocity, x0, c, nfe=n).x1 for n in (1, 32))
    assert torch.allclose(one, many)


# --- intervals ---


@pytest.mark.parametrize(("k", "n"), [(0, 10), (1, 10), (5, 10), (10, 10), (87, 100), (3, 7)])
def test_wilson_by_the_textbook(k, n):
    p, z = k / n, 1.959963985
    centre = (p + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * math.sqrt(p * (1 - p) / n + z**2 / (4 * n**2))
    low, high = wilson_interval(k, n)
    assert low == pytest.approx(centre - half, abs=1e-7)
    assert high == pytest.approx(centre + half, abs=1e-7)
    assert 0 <= low <= p <= high <= 1


def test_wilson_covers():
    rng = np.random.default_rng(0)
    for p in (0.5, 0.9):
        counts = rng.binomial(50, p, size=2000)
        intervals = {k: wilson_interval(int(k), 50) for k in set(counts.tolist())}
        covered = np.mean([intervals[k][0] <= p <= intervals[k][1] for k in counts.tolist()])
        assert 0.92 < covered < 0.98


def test_bootstrap_is_close_to_the_normal_interval():
    values = np.random.default_rng(0).normal(3.0, 2.0, size=200)
    low, high = bootstrap_interval(values)
    half = 1.96 * values.std() / math.sqrt(200)
    assert low == pytest.approx(values.mean() - half, abs=0.05)
    assert high == pytest.approx(values.mean() + half, abs=0.05)
    assert bootstrap_interval(values) == (low, high)
    assert bootstrap_interval(values, seed=1) != (low, high)
    assert bootstrap_interval([2.0, 2.0]) == (2.0, 2.0)


@pytest.mark.parametrize("n", [3, 5, 9, 12])
def test_intervals_of_few_values_cover_the_mean(n):
    """The bootstrap alone covers .74 at three values and .83 at five."""
    rng = np.random.default_rng(0)
    ends = np.array([bootstrap_interval(rng.normal(size=n), resamples=500) for _ in range(500)])
    covered = ((ends[:, 0] < 0) & (ends[:, 1] > 0)).mean()
    assert (0.92 if n < 10 else 0.87) < covered < 0.98


def test_one_network_is_widened_by_the_deviation_that_is_given():
    """The interval of its episodes covers .48 where networks deviate by .10."""
    rng, held = np.random.default_rng(0), []
    for _ in range(100):
        episodes = rng.binomial(1, rng.normal(0.5, 0.1), size=(1, 200)).astype(float)
        _, low, high = paired_bootstrap(episodes, np.zeros((1, 200)), deviation=0.1)
        held.append(low < 0.5 < high)
    assert np.mean(held) > 0.9
    one, three = np.eye(4)[:1], np.eye(4)[:3]
    assert paired_bootstrap(three, 0 * three, deviation=5.0) == paired_bootstrap(three, 0 * three)
    assert paired_bootstrap(one, 0 * one, deviation=5.0)[1] < -5


def test_joint_squared_w2_is_exact_where_conditions_are_far_apart():
    """One row per condition: nobody leaves theirs, so the distance is the rows' own."""
    a = torch.randn(20, 2, generator=seeded())
    c = torch.arange(20.0)[:, None]
    assert joint_squared_w2(a, a + 0.1, c) == pytest.approx(0.02, rel=1e-4)


def test_joint_squared_w2_weighs_conditions_by_the_spread_of_b():
    """That of the truth, so that all models are measured alike."""
    a, b, c = (torch.randn(60, 2, generator=seeded(k)) for k in range(3))
    for samples, truth in ((3 * a, b), (a, 3 * b)):
        cost = torch.cdist(samples.double(), truth.double()) ** 2
        spread = (torch.cdist(truth.double(), truth.double()) ** 2).mean()
        seen = torch.cdist(c.double(), c.double()) ** 2
        cost += 100 * spread / seen.mean() * seen
        rows, columns = linear_sum_assignment(cost.numpy())
        expected = float(cost[rows, columns].mean())
        assert joint_squared_w2(samples, truth, c) == pytest.approx(expected, rel=1e-6)


def test_l2_uvp():
    truth = torch.randn(5000, 3, generator=seeded()) * 2
    assert l2_uvp(truth, truth) == 0
    assert l2_uvp(truth.mean(dim=0).expand_as(truth), truth) == pytest.approx(100, rel=1e-3)
    assert l2_uvp(truth + 1, truth) == pytest.approx(25, rel=0.05)
    assert l2_uvp(truth + 1, truth, variance=30.0) == pytest.approx(10)


def test_paired_bootstrap_sees_what_pairing_leaves():
    rng = np.random.default_rng(0)
    hard = rng.normal(size=(1, 200))  # episodes differ much, methods little
    first = hard + 0.1 + 0.01 * rng.normal(size=(3, 200))
    second = hard + 0.01 * rng.normal(size=(3, 200))
    mean, low, high = paired_bootstrap(first, second)
    assert mean == pytest.approx((first - second).mean())
    assert 0.09 < low < mean < high < 0.11
    assert paired_bootstrap(first, first) == (0.0, 0.0, 0.0)


def test_paired_bootstrap_counts_seeds_as_well():
    """With one value a seed the interval is as wide as that of the seeds alone."""
    difference = np.repeat([[0.0], [1.0], [2.0]], 50, axis=1)
    mean, low, high = paired_bootstrap(difference, np.zeros((3, 50)))
    assert (mean, low, high) == pytest.approx((1.0, 0.0, 2.0))  # rounding depends on threads


def test_mode_entropy():
    assert mode_entropy([[0, 1, 2, 3], [3, 2, 1, 0]]) == pytest.approx(math.log(4))
    assert mode_entropy([[5, 5, 5]]) == 0
    assert mode_entropy([[0, 1], [4, 4]]) == pytest.approx(math.log(2) / 2)
    assert mode_entropy([[0, 1, -1, -1]]) == pytest.approx(math.log(2))  # the failed do not count
    assert mode_entropy([[-1, -1]]) == 0


def test_energy_score_is_least_for_the_law_itself():
    g = seeded()
    truth = torch.randn(4000, 2, generator=g)

    def score(shift, scale):
        return energy_score(shift + scale * torch.randn(16, 4000, 2, generator=g), truth)

    right = score(0.0, 1.0)
    # E|Z - Z'| / 2 for standard normal Z, Z' in the plane: sqrt(pi) / 2
    assert right == pytest.approx(math.sqrt(math.pi) / 2, abs=0.03)
    assert right < min(score(0.5, 1.0), score(0.0, 0.3), score(0.0, 2.0))


A, NONE, PETALS = normal(4), np.zeros((1, 3)), petals()
GIVEN = PETALS.sample_given
test_bad_input = refused(
    (lambda: squared_w2(np.zeros((2, 2)), A), TypeError, "a must be a torch tensor"),
    (lambda: squared_w2(A, normal(2, 3)), ValueError, "b has 3 columns, expected 2"),
    (lambda: squared_w2(A, normal(0)), ValueError, "b is empty"),
    (lambda: squared_w2(A * math.nan, A), ValueError, "a has NaN"),
    (lambda: squared_w2(A[0], A), ValueError, "a must have shape"),
    (lambda: joint_squared_w2(A, A[:3], A), ValueError, "b has 3 rows"),
    (lambda: joint_squared_w2(A, A, A[:3]), ValueError, "c has 3 rows"),
    (lambda: l2_uvp(A, A, variance=0.0), ValueError, "variance must be above 0, got 0"),
    (lambda: l2_uvp(A[:1], A[:1]), ValueError, "variance is missing"),
    (lambda: l2_uvp(A, A[:, :1]), ValueError, "truth has 1 columns, expected 2"),
    (lambda: l2_uvp(A[:3], A), ValueError, "mapped has 3 rows, truth has 4"),
    (lambda: energy_distance(normal(1), A), ValueError, "at least 2 rows each, got 1"),
    (lambda: energy_distance(A, A[:, :1]), ValueError, "b has 1 columns"),
    (lambda: conditional_squared_w2(GIVEN, PETALS, n=0), ValueError, "n must be at least 1"),
    (lambda: conditional_squared_w2(lambda c, **_: c, PETALS), ValueError, "columns, expected"),
    (lambda: straightness(lambda t, x, c: x, normal(0)), ValueError, "x0 is empty"),
    (lambda: wilson_interval(1, 0), ValueError, "trials must be at least 1"),
    (lambda: wilson_interval(-1, 5), ValueError, "successes must be at least 0"),
    (lambda: wilson_interval(6, 5), ValueError, "successes must be at most trials 5, got 6"),
    (lambda: wilson_interval(0.5, 5), TypeError, "successes must be an integer"),
    (lambda: bootstrap_interval([1.0]), ValueError, "values must be at least 2"),
    (lambda: bootstrap_interval([1.0, math.nan]), ValueError, "values has NaN"),
    (lambda: bootstrap_interval(["a", "b"]), TypeError, "values must hold real numbers"),
    (lambda: paired_bootstrap(np.zeros((2, 3)), NONE), ValueError, r"second .* \(2, 3\), got"),
    (lambda: paired_bootstrap(NONE[0], NONE[0]), ValueError, r"first must have shape \(any, any\)"),
    (lambda: paired_bootstrap(NONE[:, :1], NONE[:, :1]), ValueError, "at least 2 episodes"),
    (lambda: paired_bootstrap(NONE * np.nan, NONE), ValueError, "first has NaN"),
    (lambda: energy_score(A[None], A), ValueError, r"at least 2, n, d\), got \(1, 4, 2\)"),
    (lambda: energy_score(torch.zeros(2, 3, 2), A), ValueError, "samples must have"),
    (lambda: mode_entropy([[0.5, 1.0]]), TypeError, "modes must hold integers, got float64"),
)


@pytest.mark.parametrize("scale", [1e-8, 1e-5, 1e8])
def test_samples_of_other_sizes_have_the_same_distance_at_any_scale(scale):
    """The solver's tolerance is absolute: at 1e-8 the distance was twice as large."""
    a, b = (torch.randn(n, 2, generator=seeded(n)).double() + n / 40 for n in (40, 70))
    right = squared_w2(a, b)
    assert squared_w2(scale * a, scale * b) / scale**2 == pytest.approx(right, rel=1e-9)


def test_a_sampler_that_ignores_the_number_of_rows_is_refused():
    data = petals()

    def few(c, generator=None):
        return data.sample_given(c[:3], generator)

    with pytest.raises(ValueError, match=r"sample\(c\) has 3 rows, c has 50"):
        conditional_squared_w2(few, data, n=50)


def test_the_energy_score_far_from_zero():
    """From 26 samples on a matrix product lost digits; large ones are taken in blocks."""
    x, y = (torch.randn(*shape, generator=seeded()).double() for shape in ((30, 50, 3), (50, 3)))
    right = energy_scores(x, y)
    torch.testing.assert_close(energy_scores(x + 1e8, y + 1e8), right, rtol=1e-5, atol=1e-5)


def test_blocks_change_nothing(monkeypatch):
    x, y = (torch.randn(*shape, generator=seeded()) for shape in ((4, 50, 3), (50, 3)))
    before = energy_scores(x, y), bootstrap_interval(y[:, 0])
    monkeypatch.setattr(metrics, "AT_ONCE", 100)
    assert torch.equal(energy_scores(x, y), before[0])
    low, high = bootstrap_interval(y[:, 0])
    assert (low, high) == pytest.approx(before[1], abs=0.02)


def test_the_floor_of_stored_rows_needs_twice_as_many(recwarn):
    """Both samples of the floor were largely the same rows."""
    data = Dataset(*petals().sample(1000, seeded()))
    metrics.conditional_squared_w2(data.sample_given, data, n=100)
    assert not recwarn.list
    with pytest.warns(RuntimeWarning, match="fewer than twice n = 250: their floor is too low"):
        metrics.conditional_squared_w2(data.sample_given, data, n=250)


def test_tensors_of_any_type():
    values = torch.tensor([0.25, 0.5, 0.75])
    assert bootstrap_interval(values.bfloat16()) == bootstrap_interval(values)
    assert bootstrap_interval(values.double()) == bootstrap_interval(values.tolist())
