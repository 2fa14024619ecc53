"""The exactly solvable case against the numbers of the course, simulation and real batches."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import sqrtm
from support import refused, seeded

from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.flows import integrate
from cotlearn.gaussian import LinearGaussian, bures_map, bures_squared
from cotlearn.mixtures import Components, ConditionalGaussianMixture

EXAMPLE = LinearGaussian.example()


def other_problem():
    """Three dimensions, two conditions, b not zero."""
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    return LinearGaussian(
        A=rng.normal(size=(3, 2)),
        b=np.array([1.0, -2.0, 0.5]),
        S=root @ root.T / 3 + 0.1 * np.eye(3),
        S_c=np.array([[1.0, 0.3], [0.3, 0.5]]),
    )


FLOWS = {
    "naive": EXAMPLE.flow(0),
    "g = 1": EXAMPLE.flow(1.0),
    "g = 1, source": EXAMPLE.flow(1.0, label="source"),
    "g = inf": EXAMPLE.flow(math.inf),
    "independent": EXAMPLE.flow("independent"),
    "other, naive": other_problem().flow(0),
    "other, g = 2": other_problem().flow(2.0),
    "other, g = 2, source": other_problem().flow(2.0, label="source"),
    "other, independent": other_problem().flow("independent"),
}
flows = pytest.mark.parametrize("flow", FLOWS.values(), ids=FLOWS)


def test_the_numbers_of_the_course():
    naive = EXAMPLE.flow(0)
    assert naive.skew() == pytest.approx(1.15, abs=0.005)
    for nfe in (1, 2, 3, 10, None):
        assert naive.squared_w2(nfe) == pytest.approx(3.48, abs=0.005)
    strong = EXAMPLE.flow(30.0)
    assert strong.skew() < 1e-4
    assert strong.squared_w2(1) < 1e-4


def test_skew_and_error_fall_with_the_weight():
    weights = [0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 1e3, 1e5]
    skews = [EXAMPLE.flow(g).skew() for g in weights]
    errors = [EXAMPLE.flow(g).squared_w2(1) for g in weights]
    assert all(np.diff(skews) < 0)
    assert all(np.diff(errors) < 0)
    assert errors[-1] < 1e-9


@pytest.mark.parametrize("problem", [EXAMPLE, other_problem()], ids=["example", "other"])
@pytest.mark.parametrize("g", [0.0, 0.5, 2.0, 30.0, 1e3, 1e5, math.inf])
def test_a_deterministic_plan_has_the_same_error_at_every_nfe(problem, g):
    flow = problem.flow(g)
    for nfe in (2, 7):
        assert flow.squared_w2(nfe) == pytest.approx(flow.squared_w2(1), abs=1e-8)
    assert flow.squared_w2() == pytest.approx(flow.squared_w2(1), abs=1e-8)
    assert flow.one_step_variance() < 1e-5


@pytest.mark.parametrize("label", ["target", "source"])
def test_zero_and_infinity_are_limits(label):
    naive, small = EXAMPLE.flow(0, label=label), EXAMPLE.flow(1e-5, label=label)
    assert np.allclose(naive.joint, small.joint, atol=1e-4)
    assert naive.squared_w2(3) == pytest.approx(small.squared_w2(3), abs=1e-4)
    infinite, large = EXAMPLE.flow(math.inf, label=label), EXAMPLE.flow(1e5, label=label)
    assert np.allclose(infinite.joint, large.joint, atol=1e-4)
    assert infinite.squared_w2(1) == pytest.approx(large.squared_w2(1), abs=1e-8)


def test_infinity_is_exact():
    flow = other_problem().flow(math.inf)
    assert flow.skew() == pytest.approx(0, abs=1e-12)
    for nfe in (1, 5, None):
        assert flow.squared_w2(nfe) == pytest.approx(0, abs=1e-8)


def test_independent_error_falls_with_nfe_and_has_no_floor():
    flow = EXAMPLE.flow("independent")
    assert flow.skew() == 0
    errors = [flow.squared_w2(nfe) for nfe in (1, 2, 4, 8, 16, 32, 64, 128)]
    assert all(np.diff(errors) < 0)
    assert errors[0] == pytest.approx(np.trace(EXAMPLE.S))  # one step: the mean of p(x | c)
    assert errors[-2] / errors[-1] == pytest.approx(4, rel=0.1)  # first order, squared
    assert flow.squared_w2() == pytest.approx(0, abs=1e-12)


def test_one_step_variance_of_independent_is_the_variance_of_the_data():
    assert EXAMPLE.flow("independent").one_step_variance() == pytest.approx(np.trace(EXAMPLE.S))


def test_label_source_keeps_the_prior_and_smears_the_target():
    flow = EXAMPLE.flow(1.0, label="source")
    assert flow.skew() == 0
    assert flow.squared_w2() > 0.1
    same = EXAMPLE.flow(1.0, label="target").joint
    assert np.allclose(flow.joint[:4, :4], same[:4, :4])  # the same pairs (x0, x1)


def with_moments(covariance):
    """Rows with mean 0 and just this covariance: no Monte Carlo for what only moments decide."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(len(values) * values.clip(min=0))
    return np.vstack([root.T, -root.T])


@flows
def test_joint_law_is_a_law_with_the_right_marginals(flow):
    d = len(flow.problem.b)
    assert np.linalg.eigvalsh(flow.joint).min() > -1e-8
    assert np.allclose(flow.joint[:d, :d], np.eye(d))
    assert np.allclose(flow.joint[d : 2 * d, d : 2 * d], flow.problem.covariance[:d, :d])
    assert np.allclose(flow.joint[2 * d :, 2 * d :], flow.problem.S_c)


@pytest.mark.parametrize("g", [0.0, 0.7, 3.0, math.inf, "independent"])
def test_label_target_keeps_the_law_of_the_data(g):
    problem = other_problem()
    assert np.allclose(problem.flow(g).joint[3:, 3:], problem.covariance)


@flows
@pytest.mark.parametrize("t", [0.0, 0.3, 0.9])
def test_velocity_is_the_regression_on_what_is_seen(flow, t):
    """E[x1 - x0 | x_t, c] by least squares over points with the moments of the joint law."""
    d, points = len(flow.problem.b), with_moments(flow.joint)
    x0, x1, c = points[:, :d], points[:, d : 2 * d] + flow.problem.b, points[:, 2 * d :]
    x_t = (1 - t) * x0 + t * x1
    seen = np.hstack([x_t, c, np.ones((len(points), 1))])
    fitted = seen @ np.linalg.lstsq(seen, x1 - x0, rcond=1e-10)[0]
    assert np.allclose(flow.velocity(t, x_t, c), fitted, atol=1e-6)


@flows
def test_law_after_euler_steps_by_steps_of_a_point_cloud(flow):
    """An affine map is known from its values at 0 and at the unit vectors: no Monte Carlo."""
    d, k = flow.problem.A.shape
    c = np.linspace(-1, 1, k)
    x = np.vstack([np.zeros(d), np.eye(d)])
    for step in range(5):
        x = x + flow.velocity(step / 5, x, np.tile(c, (d + 1, 1))) / 5
    mean, covariance = flow.law_after(c, nfe=5)
    U = (x[1:] - x[0]).T
    assert np.allclose(mean, x[0])
    assert np.allclose(covariance, U @ U.T)


@flows
def test_law_of_the_exact_flow_by_another_solver(flow):
    d, k = flow.problem.A.shape
    c = np.full(k, 0.7)

    def velocity(t, x, condition):
        return torch.from_numpy(flow.velocity(float(t), x.numpy(), condition.numpy()))

    x = torch.from_numpy(np.vstack([np.zeros(d), np.eye(d)]))
    conditions = torch.from_numpy(np.tile(c, (d + 1, 1)))
    x = integrate(velocity, x, conditions, nfe=800, method="rk4").x1.numpy()
    mean, covariance = flow.law_after(c)
    U = (x[1:] - x[0]).T
    assert np.allclose(mean, x[0], atol=1e-6)
    assert np.allclose(covariance, U @ U.T, atol=1e-6)


@flows
def test_squared_w2_is_the_mean_over_conditions_of_that_between_gaussians(flow):
    problem, values = flow.problem, []
    for c in with_moments(problem.S_c):  # enough, because the distance is quadratic in c
        mean, covariance = flow.law_after(c, nfe=2)
        truth = problem.A @ c + problem.b
        root = sqrtm(problem.S)
        mixed = np.real(sqrtm(root @ covariance @ root))
        traces = np.trace(covariance + problem.S) - 2 * np.trace(mixed)
        values.append(np.sum((mean - truth) ** 2) + traces)
    assert flow.squared_w2(2) == pytest.approx(np.mean(values), abs=1e-6)


@flows
def test_skew_is_the_distance_of_the_noise_given_c_from_the_prior(flow):
    """Over points with the moments of c: mean of x0 given c squared, plus the Bures term."""
    d = len(flow.problem.b)
    x0_c, S_c = flow.joint[:d, 2 * d :], flow.joint[2 * d :, 2 * d :]
    covariance = np.eye(d) - x0_c @ np.linalg.inv(S_c) @ x0_c.T
    mean = with_moments(S_c) @ np.linalg.inv(S_c) @ x0_c.T
    bures = np.trace(covariance) + d - 2 * np.trace(np.real(sqrtm(covariance)))
    expected = np.square(mean).sum(axis=1).mean() + bures
    assert flow.skew() == pytest.approx(expected, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("g", [0.0, 1.0, 4.0])
def test_a_large_batch_comes_close_to_the_infinite_one(g):
    """Covariances of the pairs that `ConditionalOT` makes from 1,500 points, three batches.

    Both labels have the same pairs, and target is c of x1: see `test_conditional.py`.
    """
    rng = np.random.default_rng(3)
    measured = {"target": [], "source": []}
    for seed in range(3):
        x1, c = (torch.from_numpy(part) for part in EXAMPLE.sample(1500, rng))
        x0 = torch.from_numpy(rng.normal(size=(1500, 2)))
        coupling = ConditionalOT(g**2, label="source")
        pairs = coupling(x0, x1, c, generator=seeded(seed))
        for label, seen in (("target", c[pairs.target_index]), ("source", pairs.c)):
            measured[label].append(np.cov(np.hstack([pairs.x0, pairs.x1, seen]).T))
    for label, found in measured.items():
        expected = EXAMPLE.flow(g, label=label).joint
        assert np.abs(np.mean(found, axis=0) - expected).max() < 0.12


def test_the_other_couplings_of_a_large_batch():
    x1, c = (torch.from_numpy(part) for part in EXAMPLE.sample(2000, np.random.default_rng(0)))
    x0 = torch.randn(2000, 2, generator=seeded(), dtype=torch.float64)
    for coupling, g in ((MinibatchOT(), 0.0), (Independent(), "independent")):
        pairs = coupling(x0, x1, c)
        measured = np.cov(np.hstack([pairs.x0, pairs.x1, pairs.c]).T)
        assert np.abs(measured - EXAMPLE.flow(g).joint).max() < 0.2


def test_independent_velocity_is_that_of_a_mixture_of_one():
    problem = LinearGaussian(
        A=np.array([[1.5], [-0.5]]), b=np.array([0.3, 0.1]), S=np.diag([0.25, 0.64]), S_c=np.eye(1)
    )

    def components(c):
        means = c @ torch.from_numpy(problem.A.T) + torch.from_numpy(problem.b)
        stds = torch.tensor([0.5, 0.8], dtype=torch.float64).expand(len(c), 1, 2)
        return Components(torch.zeros(len(c), 1), means[:, None], stds)

    mixture = ConditionalGaussianMixture("one", 2, 1, components, None, None)
    x, c = torch.randn(20, 2).double(), torch.randn(20, 1).double()
    flow = problem.flow("independent")
    for t in (0.0, 0.4, 1.0):
        expected = mixture.velocity(t, x, c).numpy()
        assert np.allclose(flow.velocity(t, x.numpy(), c.numpy()), expected)


def test_sample_has_the_stated_law():
    problem = other_problem()
    x1, c = problem.sample(200_000, np.random.default_rng(0))
    assert np.allclose(np.cov(np.hstack([x1, c]).T), problem.covariance, atol=0.06)
    assert np.allclose(x1.mean(axis=0), problem.b, atol=0.03)
    assert np.allclose(c.mean(axis=0), 0, atol=0.03)


@pytest.mark.parametrize("unit", [1e-8, 1e-5, 1e6])
@pytest.mark.parametrize("g", ["independent", math.inf])
def test_the_unit_of_the_condition_changes_nothing(unit, g):
    """In small units the condition was ignored: 2.5 for an error of 0."""
    scaled = replace(EXAMPLE, A=EXAMPLE.A / unit, S_c=EXAMPLE.S_c * unit**2)
    plain, flow = EXAMPLE.flow(g), scaled.flow(g)
    assert flow.one_step_variance() == pytest.approx(plain.one_step_variance(), abs=1e-6)
    for nfe in (1, 3, None):
        assert flow.squared_w2(nfe) == pytest.approx(plain.squared_w2(nfe), abs=1e-6)
    c = np.ones(1)
    for one, other in zip(flow.law_after(unit * c, 1), plain.law_after(c, 1), strict=True):
        assert one == pytest.approx(other, abs=1e-6)


def test_small_data_are_solved_or_refused():
    small = replace(EXAMPLE, A=EXAMPLE.A * 1e-5, S=EXAMPLE.S * 1e-10)
    assert small.flow(math.inf).squared_w2(None) < 1e-6 * 1e-10
    tiny = replace(EXAMPLE, A=EXAMPLE.A * 1e-8, S=EXAMPLE.S * 1e-16)
    with pytest.raises(ValueError, match="x1 must have deviations of at least 1e-06"):
        tiny.flow(math.inf).squared_w2(None)
    assert tiny.flow(math.inf).squared_w2(1) < 1e-6 * 1e-16


def test_bures():
    assert bures_squared(np.array([[4.0]]), np.array([[9.0]])) == pytest.approx(1.0)
    A, B = EXAMPLE.S, np.array([[2.0, -0.3], [-0.3, 0.4]])
    assert bures_squared(A, A) == pytest.approx(0, abs=1e-12)
    assert bures_squared(A, B) == pytest.approx(bures_squared(B, A))
    M = bures_map(A, B)
    assert np.allclose(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0
    assert np.allclose(M @ A @ M, B)


test_bad_problems = refused(
    ({"A": [1.0, 2.0]}, r"A must have shape \(any, any\), got \(2,\)"),
    ({"A": [[1.0], [math.nan]]}, "A has NaN"),
    ({"b": [0.0]}, r"b must have shape \(2,\), got \(1,\)"),
    ({"S": np.eye(3)}, r"S must have shape \(2, 2\)"),
    ({"S": [[1.0, 2.0], [0.0, 1.0]]}, "S must be (symmetric|positive definite)"),
    ({"S": -np.eye(2)}, "S must be (symmetric|positive definite)"),
    ({"S_c": [[0.0]]}, "S_c must be positive definite"),
    error=ValueError,
    of=lambda **change: replace(EXAMPLE, **change),
)


FLOW = EXAMPLE.flow(1.0)
test_bad_input = refused(
    (lambda: EXAMPLE.flow(-1), ValueError, "g must be at least 0"),
    (lambda: EXAMPLE.flow(math.nan), ValueError, "g must be at least 0"),
    (lambda: EXAMPLE.flow("naive"), ValueError, "g must be one of independent; got 'naive'"),
    (lambda: EXAMPLE.flow(None), TypeError, "g must be a number"),
    (lambda: EXAMPLE.flow(1e9), ValueError, "g = 1e.09 is too large .* math.inf"),
    (lambda: EXAMPLE.flow(1.0, label="both"), ValueError, "label must be one of target, source"),
    (lambda: FLOW.squared_w2(0), ValueError, "nfe must be at least 1"),
    (lambda: FLOW.squared_w2(2.0), TypeError, "nfe must be an integer"),
    (lambda: FLOW.law_after([1.0, 2.0]), ValueError, r"c must have shape \(1,\)"),
    (lambda: FLOW.velocity(1.5, [[0, 0]], [[0]]), ValueError, r"t must lie in"),
    (lambda: EXAMPLE.sample(0, np.random.default_rng()), ValueError, "n must be at least 1"),
)


@pytest.mark.parametrize(
    ("matrix", "why"),
    [
        (-np.eye(2), "positive semi-definite"),
        (np.diag([1.0, -1.0]), "positive semi-definite"),
        (np.array([[1e-9, 5e-9], [0, 1e-9]]), "symmetric"),
    ],
)
def test_what_is_no_covariance_is_refused(matrix, why):
    with pytest.raises(ValueError, match=f"first must be {why}"):
        bures_squared(matrix, np.eye(2))
