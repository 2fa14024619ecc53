"""The solvers against brute force, SciPy and POT."""

import itertools

import numpy as np
import ot
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from support import seeded

from cotlearn.couplings import assignment
from cotlearn.couplings.assignment import SMALL_BATCH, draw_pairs, exact_permutation, sinkhorn_plan
from cotlearn.couplings.distances import squared_distances


def points(n, d, seed=0, kind="normal"):
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(2, n, d))
    if kind == "duplicates":  # few distinct points, many ties
        x, y = x[rng.integers(max(n // 5, 1), size=n)], y[rng.integers(max(n // 5, 1), size=n)]
    if kind == "integers":
        x, y = np.round(2 * x), np.round(2 * y)
    return cdist(x, y, "sqeuclidean")


def total(cost, columns):
    return cost[np.arange(len(cost)), columns].sum()


def assert_optimal(cost, rel=1e-12):
    """By SciPy."""
    expected = total(cost, linear_sum_assignment(cost)[1])
    assert total(cost, exact_permutation(cost)) == pytest.approx(expected, rel=rel)


@pytest.mark.parametrize("seed", range(20))
def test_brute_force_over_all_permutations(seed):
    cost = np.random.default_rng(seed).normal(size=(4, 4))
    best = min(itertools.permutations(range(4)), key=lambda p: total(cost, list(p)))
    assert tuple(exact_permutation(cost)) == best


@pytest.mark.parametrize("kind", ["normal", "duplicates", "integers"])
@pytest.mark.parametrize("dim", [1, 2, 3, 8, 32])
@pytest.mark.parametrize("n", [1, 2, 7, SMALL_BATCH, SMALL_BATCH + 1, 130, 300])
def test_scipy_and_pot_find_nothing_cheaper(n, dim, kind):
    cost = points(n, dim, kind=kind)
    weights = np.full(n, 1 / n)
    expected = total(cost, linear_sum_assignment(cost)[1])
    assert n * ot.emd2(weights, weights, cost) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    columns = exact_permutation(cost)
    assert columns.dtype == np.int64
    assert np.array_equal(np.sort(columns), np.arange(n))
    assert total(cost, columns) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("dim", [2, 16])
def test_a_large_batch(dim):
    assert_optimal(points(1100, dim), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("regularization", [0.01, 0.05, 1.0])
@pytest.mark.parametrize("dim", [2, 16])
def test_the_largest_sum_of_entries_of_a_plan(dim, regularization):
    assert_optimal(-sinkhorn_plan(points(256, dim), regularization=regularization))


@pytest.mark.parametrize("n", [80, 300, 1000])
def test_clusters_far_apart(n):
    rng = np.random.default_rng(0)
    x, y = 0.5 * rng.normal(size=(2, n, 2)) + [[0.0, 6.0]] * rng.choice([-1, 1], size=(2, n, 1))
    assert_optimal(cdist(x, y, "sqeuclidean"))


@pytest.mark.parametrize("kind", ["equal", "one outlier", "one bargain", "huge weight"])
def test_costs_whose_potentials_are_of_no_use(kind):
    cost = points(200, 2)
    if kind == "equal":
        cost = np.full_like(cost, 3.0)
    elif kind == "one outlier":
        cost[7] += 1e12
    elif kind == "one bargain":
        cost[7, 3] -= 1e12
    else:
        cost += 1e9 * points(200, 1, seed=1)
    assert_optimal(cost)


@pytest.mark.parametrize("scale", [1e-300, 1e-12, 1e-6, 1.0, 1e6, 1e12, 1e300])
@pytest.mark.parametrize("shift", [0.0, -5.0])
@pytest.mark.parametrize("dim", [2, 16])
def test_scale_and_sign_of_the_cost_do_not_matter(scale, shift, dim):
    cost = points(220, dim)
    best = exact_permutation(cost)
    columns = exact_permutation(scale * (cost + shift))
    assert total(cost, columns) == pytest.approx(total(cost, best), rel=1e-9)


def outliers(rng, n):
    x, y = rng.normal(size=(2, n, rng.choice([2, 16])))
    some = rng.integers(1, n // 4)
    y[:some] *= 10.0 ** rng.integers(3, 11)
    return ((x[:, None].astype(np.longdouble) - y) ** 2).sum(axis=2)


def powers(rng, n):
    return 10.0 ** rng.uniform(-6, 6, size=(n, n))


def shifted(rng, n):
    cost, shift = rng.random((n, n)), 10.0 ** rng.integers(3, 10)
    return cost + shift * rng.random((n, 1)) + shift * rng.random(n) * rng.integers(2)


def integers(rng, n):
    return rng.integers(0, rng.integers(2, 12), size=(n, n)) * 1.0


def labels(rng, n):
    c = rng.integers(0, 5, size=n)
    x, y = rng.normal(size=(2, n, 2))
    return cdist(x, y, "sqeuclidean") + 10.0 ** rng.integers(2, 9) * (
        c[:, None] != rng.permutation(c)
    )


@pytest.mark.parametrize("make", [outliers, powers, shifted, integers, labels])
def test_no_nasty_matrix_of_sixty_gets_a_worse_permutation(make):
    """The judge has SciPy's solver on costs that were reduced in extended precision.

    A huge cost for some columns must not spoil the pairs of the others: one row of 1e8 made them
    12 % dearer.
    """
    rng = np.random.default_rng(0)
    for _ in range(60):
        exact = np.asarray(make(rng, int(rng.integers(60, 110))), dtype=np.longdouble)
        columns = exact_permutation(exact.astype(np.float64))
        reduced = exact - exact.min(axis=0)
        reduced -= reduced.min(axis=1, keepdims=True)
        best = linear_sum_assignment(reduced.astype(np.float64))[1]
        paid, least = (total(exact - exact.min(axis=0), p) for p in (columns, best))
        lost = (
            64 * np.finfo(float).eps * float(abs(exact).max())
        )  # the costs themselves are rounded
        assert paid <= least * (1 + 1e-9) + lost
        near = exact.astype(float).max(axis=0) < 1e3 * np.median(exact.astype(float))
        sums = [float(exact[np.arange(len(p)), p][near[p]].sum()) for p in (columns, best)]
        if make is outliers:
            assert sums[0] == pytest.approx(sums[1], rel=1e-6)


@pytest.mark.parametrize("n", [40, 200])
def test_costs_that_no_solver_can_tell_apart_are_said(n):
    cost = points(n, 2)
    cost[:, 3] += 1e18 * np.random.default_rng(0).random(n)
    with pytest.warns(RuntimeWarning, match="costs up to .*e.1. hide the others"):
        exact_permutation(cost)
    exact_permutation(points(n, 2) + 1e6)  # not a word


@pytest.mark.parametrize("make", [integers, shifted])
def test_ties_and_shifted_rows_end_soon(make, monkeypatch):
    """Long paths go to SciPy after 16 scans for each row; 1,024 rows took 440 scans and 4 s."""
    cost, asked = make(np.random.default_rng(1), 700), []
    monkeypatch.setattr(
        assignment, "linear_sum_assignment", lambda c: asked.append(1) or linear_sum_assignment(c)
    )
    columns = exact_permutation(cost)
    assert asked
    assert total(cost, columns) == pytest.approx(total(cost, linear_sum_assignment(cost)[1]))


@pytest.mark.parametrize("axis", [0, 1])
def test_the_constants_that_differ_more_leave_first(axis, monkeypatch):
    """In the other order SciPy takes 15 times as long at 1,000 rows (0.77 s; 0.05 s)."""
    rng, asked = np.random.default_rng(0), []
    plain = rng.random((90, 90))
    cost = plain + 1e9 * rng.random((90, 1) if axis else 90)
    monkeypatch.setattr(
        assignment, "linear_sum_assignment", lambda c: asked.append(c) or linear_sum_assignment(c)
    )
    columns = exact_permutation(cost)
    wanted = plain - plain.min(axis=axis, keepdims=True)
    wanted -= wanted.min(axis=1 - axis, keepdims=True)
    np.testing.assert_allclose(asked[0], wanted, atol=1e-6)
    assert total(plain, columns) == pytest.approx(
        total(plain, linear_sum_assignment(plain)[1]), abs=1e-5
    )


def test_one_dimension_is_sorting():
    x, y = np.random.default_rng(0).normal(size=(2, 150))
    columns = exact_permutation((x[:, None] - y[None]) ** 2)
    assert np.array_equal(np.argsort(x).argsort(), np.argsort(y[columns]).argsort())


@pytest.mark.slow
def test_the_cost_is_not_changed():
    for n in (50, 150):
        cost = points(n, 2)
        before = cost.copy()
        exact_permutation(cost)
        sinkhorn_plan(cost, regularization=0.05)
        assert np.array_equal(cost, before)


def test_float32_and_transposed_costs():
    cost = points(120, 2)
    expected = total(cost, exact_permutation(cost))
    single = exact_permutation(cost.astype(np.float32))
    assert total(cost, single) == pytest.approx(expected, rel=1e-5)
    assert total(cost.T, exact_permutation(cost.T)) == pytest.approx(expected)


@pytest.mark.parametrize("regularization", [0.02, 0.05, 0.5, 5.0])
@pytest.mark.parametrize("kind", ["normal", "duplicates"])
def test_sinkhorn_marginals(regularization, kind):
    n = 40
    plan = sinkhorn_plan(points(n, 2, kind=kind), regularization=regularization)
    assert plan.min() >= 0
    assert np.abs(plan.sum(axis=0) - 1 / n).max() < 1e-4
    assert np.abs(plan.sum(axis=1) - 1 / n).max() < 1e-4


@pytest.mark.parametrize("regularization", [0.02, 0.05, 0.3, 2.0])
def test_sinkhorn_is_pots(regularization):
    cost = points(64, 2)
    weights = np.full(64, 1 / 64)
    options = {"stopThr": 1e-6, "warn": False}
    expected = ot.sinkhorn(weights, weights, cost / cost.mean(), regularization, **options)
    found = sinkhorn_plan(cost, regularization=regularization)
    assert np.abs(found - expected).max() < 1e-6


def test_sinkhorn_lies_between_the_exact_and_the_independent_plan():
    cost = points(40, 2)
    exact = total(cost, exact_permutation(cost)) / 40
    costs = [(sinkhorn_plan(cost, regularization=r) * cost).sum() for r in (0.02, 0.1, 1, 100)]
    assert costs == sorted(costs)
    assert costs[0] == pytest.approx(exact, rel=0.1)
    assert costs[0] > exact
    assert costs[-1] == pytest.approx(cost.mean(), rel=0.01)


def test_sinkhorn_does_not_depend_on_the_scale():
    cost = points(20, 2)
    plan = sinkhorn_plan(cost, regularization=0.1)
    assert np.allclose(plan, sinkhorn_plan(1e6 * cost, regularization=0.1), atol=1e-9)
    assert np.allclose(sinkhorn_plan(0 * cost, regularization=0.1), 1 / 400)


def test_drawn_pairs_follow_the_plan():
    plan = np.array([[0.5, 0.0], [0.2, 0.3]])
    rows, columns = draw_pairs(plan, 50_000, np.random.default_rng(0))
    share = np.histogram2d(rows, columns, bins=2)[0] / 50_000
    assert np.allclose(share, plan, atol=0.01)
    assert share[0, 1] == 0


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (np.zeros((3, 4)), r"cost must be a non-empty square matrix, got shape \(3, 4\)"),
        (np.zeros((0, 0)), "cost must be a non-empty square"),
        (np.zeros(3), "cost must be a non-empty square"),
        (np.full((2, 2), np.nan), "cost has NaN"),
        (np.full((2, 2), np.inf), "cost has NaN or infinite"),
    ],
)
def test_bad_costs(cost, message):
    with pytest.raises(ValueError, match=message):
        exact_permutation(cost)
    with pytest.raises(ValueError, match=message):
        sinkhorn_plan(cost, regularization=0.1)


@pytest.mark.parametrize("regularization", [0, -1.0, np.nan, np.inf])
def test_bad_regularization(regularization):
    with pytest.raises(ValueError, match="regularization must be"):
        sinkhorn_plan(np.eye(2), regularization=regularization)


@pytest.mark.parametrize("regularization", [0.05, 1.0])
@pytest.mark.parametrize("shift", [0.3, 0.5, 1.0, 5.0])
def test_a_plan_of_negative_costs_is_a_plan(shift, regularization):
    """Its mass was 88, or not a number."""
    plan = sinkhorn_plan(
        np.random.default_rng(0).random((64, 64)) - shift, regularization=regularization
    )
    for axis in (0, 1):
        assert plan.sum(axis=axis) == pytest.approx(1 / 64, rel=1e-3)


def test_a_plan_that_did_not_converge_is_said():
    """A column was off by 100 %."""
    with pytest.warns(RuntimeWarning, match="has not converged: a marginal is .* % off"):
        sinkhorn_plan(points(40, 2), regularization=1e-4)


@pytest.mark.filterwarnings("error")
def test_repeated_rows_are_no_rows_far_off():
    """Their costs differ by rounding, and a warning asked to leave out what was far off."""
    for seed in range(4):
        x1 = torch.rand(6, 784, generator=seeded(seed)).repeat(2, 1)
        x0 = torch.randn(12, 784, generator=seeded(9))
        exact_permutation(squared_distances(x0, x1))


def test_integers_that_float64_rounds_are_refused():
    """Of 2^60 and small differences the pairs were random."""
    small = np.random.default_rng(0).integers(0, 20, (12, 12))
    with pytest.raises(ValueError, match="integers above 2\\^53, which float64 rounds"):
        exact_permutation(2**60 + small)
    rows = np.arange(12)
    least = small[rows, linear_sum_assignment(small)[1]].sum()
    assert small[rows, exact_permutation(2**50 + small)].sum() == least
