"""Action Matching: identities I2 and I3, variance of its times, and what the middle does."""

import functools
import math

import pytest
import torch
from scipy.optimize import minimize
from small import make_pairs, network
from support import same_weights, seeded

from cotlearn.couplings import Independent
from cotlearn.flows import fit, integrate, interpolate
from cotlearn.metrics import l2_uvp
from cotlearn.potentials import ICNN, KnownMap, LogSumExp, dual_loss, dual_objective, transport
from cotlearn.potentials.action import ActionMLP, OptimalAction, action_matching_loss


def bent(x0, x1, t):
    """A path that makes a detour."""
    detour = torch.tensor([0.0, 4.0], dtype=x0.dtype)
    return interpolate(x0, x1, t) + (math.pi * t).sin()[:, None] * detour


def differences(action, t, x, c, h=1e-5):
    """ds/dt and grad s."""
    steps = h * torch.eye(2, dtype=x.dtype)
    with torch.no_grad():
        by_t = (action(t + h, x, c) - action(t - h, x, c)) / (2 * h)
        by_x = [(action(t, x + e, c) - action(t, x - e, c)) / (2 * h) for e in steps]
    return by_t, torch.stack(by_x, dim=1)


@pytest.mark.parametrize("condition_dim", [0, 2])
@pytest.mark.parametrize("t", [0.02, 0.5, 0.97])
def test_i3_pointwise(t, condition_dim):
    """grad s = u, ds/dt = -|u|^2/2, both against finite differences of s."""
    action, pairs = OptimalAction(network(condition_dim)), make_pairs(condition_dim=condition_dim)
    by_t, by_x = action.derivatives(t, pairs.x1, pairs.c)
    numeric_t, numeric_x = differences(action, t, pairs.x1, pairs.c)
    assert torch.allclose(numeric_t, by_t, atol=1e-6, rtol=1e-5)
    assert torch.allclose(numeric_x, by_x, atol=1e-6, rtol=1e-5)
    assert torch.allclose(by_t + by_x.square().sum(dim=1) / 2, torch.zeros(64).double())


def test_action_is_the_conjugate_formula():
    """s_t = |x|^2/(2t) - Phi_t^*(x)/t, the conjugate maximised by SciPy."""
    net, x, t = network(), make_pairs(4).x1, 0.6

    def conjugate(row):
        def negative(z):
            point = torch.tensor(z)[None]
            phi = (1 - t) / 2 * point.square().sum() + t * net(point)[0]
            return float((phi - point[0] @ row).detach())

        return -minimize(negative, [0.0, 0.0], tol=1e-12).fun

    for row, value in zip(x, OptimalAction(net)(t, x).detach(), strict=True):
        assert float(row @ row / 2 - conjugate(row)) / t == pytest.approx(float(value), abs=1e-6)


def test_ends_of_the_action():
    net, pairs = network(), make_pairs()
    action, (x0, x1) = OptimalAction(net), (pairs.x0, pairs.x1)
    start = net(x0) - x0.square().sum(dim=1) / 2
    end = x1.square().sum(dim=1) / 2 - (dual_objective(net, x0, x1) - net(x0))
    assert torch.allclose(action(0.0, x0), start)
    assert torch.allclose(action(1.0, x1), end)


@pytest.mark.parametrize("path", [interpolate, bent])
@pytest.mark.parametrize("condition_dim", [0, 2])
def test_optimal_action_matching_is_the_dual_for_any_middle(path, condition_dim):
    net, pairs = network(condition_dim), make_pairs(condition_dim=condition_dim)
    ends = (pairs.x0.square() + pairs.x1.square()).sum(dim=1) / 2
    dual = dual_objective(net, pairs.x0, pairs.x1, pairs.c) - ends
    loss = action_matching_loss(OptimalAction(net), pairs, path=path)
    assert torch.allclose(loss, dual, atol=1e-9)
    first, second = (
        torch.autograd.grad(value.mean(), list(net.parameters()), retain_graph=True)
        for value in (loss, dual_loss(net, pairs) / 2)
    )
    assert all(torch.allclose(a, b, atol=1e-8) for a, b in zip(first, second, strict=True))


def test_i2_by_monte_carlo():
    """L_FM(grad s) = 2 L_AM(s) + E|x1 - x0|^2, on the same pairs and times."""
    pairs = make_pairs(40_000)
    action = ActionMLP(2, width=32, depth=2, seed=0).double()
    with torch.no_grad():
        seed = seeded(1)
        am = action_matching_loss(action, pairs, seed)
        t = torch.rand(len(pairs), generator=seeded(2)).double()
        straight = pairs.x1 - pairs.x0
        field = action.velocity(t, interpolate(pairs.x0, pairs.x1, t))
        fm = (field - straight).square().sum(dim=1)
    gap = fm - 2 * am - straight.square().sum(dim=1)
    error = float(gap.std()) / len(gap) ** 0.5
    assert abs(float(gap.mean())) < 4 * error
    assert error < 0.05 * float(straight.square().sum(dim=1).mean())  # the interval says something


def test_free_action_derivatives_against_finite_differences():
    action, x = ActionMLP(2, 1, width=8, depth=2, seed=0).double(), make_pairs().x1
    c = torch.rand(64, 1).double()
    found, numeric = action.derivatives(0.4, x, c), differences(action, 0.4, x, c)
    assert all(torch.allclose(a, b, atol=1e-7) for a, b in zip(numeric, found, strict=True))


def test_stratified_times_take_out_variance():
    class OfTimeAlone:
        def __call__(self, t, x, c=None):
            return torch.zeros(len(x), dtype=x.dtype)

        def derivatives(self, t, x, c=None):
            return (6 * t).cos(), torch.zeros_like(x)

    pairs = make_pairs(64)
    found, independent = [], []
    for seed in range(100):
        g = seeded(seed)
        found.append(action_matching_loss(OfTimeAlone(), pairs, g).mean())
        independent.append((6 * torch.rand(64, generator=g)).cos().mean())
    found = torch.stack(found)
    assert found.var() < 0.002 * torch.stack(independent).var()
    assert abs(float(found.mean()) - math.sin(6) / 6) < 4 * float(found.std()) / 10


@pytest.mark.slow
def test_free_action_follows_the_middle_and_the_optimal_one_does_not():
    data = KnownMap(lambda x: x + torch.tensor([4.0, 0.0]), 2)
    options = {"steps": 250, "batch_size": 128, "learning_rate": 1e-2, "seed": 0}
    loss = functools.partial(action_matching_loss, path=bent)
    x0 = torch.randn(500, 2, generator=seeded(9))
    free = fit(ActionMLP(2, width=32, depth=2, seed=0), data, _Shift(), loss=loss, **options)
    path = integrate(free.network.velocity, x0, nfe=20, trajectory=True)
    assert 2 < float(path.trajectory[10].mean(dim=0)[1]) < 6  # the detour is 4 high
    options["learning_rate"] = 5e-2
    action = OptimalAction(ICNN(2, width=16, depth=1, seed=0))
    best = fit(action, data, _Shift(), loss=loss, **options)
    middle = integrate(best.network.velocity, x0, nfe=2, trajectory=True).trajectory[1]
    assert abs(float(middle.mean(dim=0)[1])) < 0.3
    assert l2_uvp(transport(best.network.potential, x0), data.transport(x0)) < 2


class _Shift(Independent):
    """Pairs x1 with the noise it came from, so that the free middle is a moving Gaussian."""

    def match(self, x0, x1, c, rng):
        return super().match(x0, x1, c, rng)._replace(x1=x0 + torch.tensor([4.0, 0.0]))


@pytest.mark.slow
def test_optimal_action_matching_trains_to_the_map():
    data = KnownMap(LogSumExp(2, seed=0).gradient, 2)
    net = ICNN(2, width=32, depth=2, seed=0).start_at_gaussian(data.sample(2000)[0])
    x0 = torch.randn(1000, 2, generator=seeded(9))
    options = {"steps": 200, "batch_size": 128, "learning_rate": 3e-2, "loss": action_matching_loss}
    trained = fit(OptimalAction(net), data, Independent(), **options).network.potential
    before, after = (l2_uvp(transport(p, x0), data.transport(x0)) for p in (net, trained))
    assert after < before / 2


def test_velocities_for_integrate():
    net, x0 = network(1), make_pairs().x0
    c = torch.rand(64, 1).double()
    made = integrate(OptimalAction(net).velocity, x0, c, nfe=3).x1
    assert torch.allclose(made, transport(net, x0, c), atol=1e-7)
    free = ActionMLP(2, 1, seed=0).double()
    assert integrate(free.velocity, x0, c, nfe=2).x1.shape == (64, 2)
    assert not free.velocity(0.5, x0, c).is_leaf  # it trains outside no_grad


def test_seeds_and_dtype():
    first = ActionMLP(2, seed=3)
    assert same_weights(first, ActionMLP(2, seed=3))
    pairs = make_pairs()
    values = [action_matching_loss(first.double(), pairs, seeded()) for _ in range(2)]
    assert torch.equal(*values)
    assert values[0].dtype == torch.float64


X = torch.zeros(4, 2)


@pytest.mark.parametrize("t", [-0.1, 1.5, math.nan])
def test_times_outside_the_interval(t):
    action = OptimalAction(ICNN(2))
    for use in (action, action.derivatives, action.velocity):
        with pytest.raises(ValueError, match=r"t must lie in \[0, 1\]"):
            use(t, X)


def test_bad_input():
    pairs = make_pairs()
    action = ActionMLP(2).double()
    with pytest.raises(ValueError, match=r"path must return shape \(64, 2\), got \(64, 1\)"):
        action_matching_loss(action, pairs, path=lambda x0, x1, t: x0[:, :1])
