"""Convex in x by construction, started at the Gaussian map, clear about wrong use."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from support import refused, same_weights, seeded
from torch import nn

from cotlearn.potentials import ICNN, PICNN, ConvexPotential, LogSumExp, transport
from cotlearn.potentials.convex import START, _ByAutodiff

NETWORKS = st.tuples(st.integers(1, 5), st.integers(0, 3), st.integers(1, 3), st.integers(0, 10**6))


class Quadratic(ConvexPotential):
    """<x, A x>/2 + <b, x>, by autodiff."""

    def __init__(self, A, b):
        super().__init__(len(b))
        self.A, self.b = nn.Parameter(A), nn.Parameter(b)

    def value(self, x, c):
        return ((x @ self.A) * x).sum(dim=1) / 2 + x @ self.b


def random_network(dim, condition_dim, depth, seed):
    """Any network: every parameter is drawn anew, some large."""
    if condition_dim:
        net = PICNN(dim, condition_dim, width=7, depth=depth, condition_width=5, seed=seed)
    else:
        net = ICNN(dim, width=7, depth=depth, seed=seed)
    generator = seeded(seed)
    with torch.no_grad():
        for p in net.parameters():
            scale = 3 * torch.rand((), generator=generator)
            p.copy_(scale * torch.randn(p.shape, generator=generator))
    return net.double()


def points(n, dim, condition_dim, seed=0):
    generator = seeded(seed)
    x, y = 3 * torch.randn(2, n, dim, dtype=torch.float64, generator=generator)
    c = torch.randn(n, condition_dim, dtype=torch.float64, generator=generator)
    return x, y, (c if condition_dim else None)


@settings(max_examples=40, deadline=None)
@given(NETWORKS, st.floats(0, 1))
def test_midpoint_inequality(shape, share):
    net = random_network(*shape)
    x, y, c = points(20, net.dim, net.condition_dim, shape[-1])
    between = net(share * x + (1 - share) * y, c)
    above = share * net(x, c) + (1 - share) * net(y, c)
    strong = net.alpha / 2 * share * (1 - share) * (x - y).square().sum(dim=1)
    assert (between + strong <= above + 1e-9 * (1 + above.abs())).all()


@settings(max_examples=40, deadline=None)
@given(NETWORKS)
def test_hessian_eigenvalues_are_at_least_alpha(shape):
    net = random_network(*shape)
    x, _, c = points(20, net.dim, net.condition_dim, shape[-1])
    H = net.hessian(x, c)
    assert torch.equal(H, H.mT) or torch.allclose(H, H.mT, rtol=1e-9)
    values = torch.linalg.eigvalsh(H)
    assert (values >= net.alpha - 1e-9 * (1 + values.abs().max())).all()


@pytest.mark.parametrize("condition_dim", [0, 2])
@pytest.mark.parametrize("depth", [1, 3])
@pytest.mark.parametrize("dim", [1, 2, 5])
def test_gradient_and_hessian_agree_with_autodiff(dim, condition_dim, depth):
    net = random_network(dim, condition_dim, depth, 3)
    x, _, c = points(6, dim, condition_dim)
    auto = _ByAutodiff(net, c)
    assert torch.allclose(net.gradient(x, c), auto.gradient(x), rtol=1e-9)
    assert torch.allclose(net.hessian(x, c), auto.hessian(x), rtol=1e-9)
    some = torch.tensor([4, 1])
    assert torch.allclose(net.given(c).rows(some).gradient(x[some]), auto.gradient(x)[some])


def test_gradient_leads_to_the_parameters():
    for net, c in ((ICNN(2, seed=0), None), (PICNN(2, 1, seed=0), torch.ones(4, 1))):
        net.gradient(torch.randn(4, 2), c).square().sum().backward()
        assert all(p.grad is not None and torch.isfinite(p.grad).all() for p in net.parameters())
    user = Quadratic(torch.eye(2), torch.ones(2))
    user.gradient(torch.randn(4, 2)).sum().backward()
    assert user.A.grad.abs().sum() > 0


def test_picnn_is_not_convex_in_c():
    net = PICNN(2, 1, seed=0).double()
    with torch.no_grad():
        net.gaussian[-1].weight.mul_(10)
    c = torch.linspace(-3, 3, 61, dtype=torch.float64)[:, None]
    x = torch.full((61, 2), 0.1, dtype=torch.float64)
    values = torch.stack([net(x, c), net(-x, c)]).detach()
    bend = values[:, 2:] + values[:, :-2] - 2 * values[:, 1:-1]
    assert bend.min() < 0 < bend.max()


def test_icnn_starts_at_the_gaussian_map():
    generator = seeded()
    x0 = torch.randn(2000, 3, generator=generator)
    A = torch.tensor([[2.0, 0.5, 0.0], [0.5, 1.0, 0.2], [0.0, 0.2, 0.6]])
    x1 = torch.randn(50_000, 3, generator=generator) @ A + torch.tensor([1.0, -2.0, 4.0])
    made = ICNN(3, seed=0).start_at_gaussian(x1).gradient(x0)
    truth = x0 @ A + torch.tensor([1.0, -2.0, 4.0])
    assert (made - truth).square().sum(dim=1).mean() < 0.02 * truth.var(dim=0).sum()


@pytest.mark.slow
@pytest.mark.parametrize("c", [torch.eye(3)[torch.arange(3000) % 3], torch.rand(3000, 1) * 2 - 1])
def test_picnn_starts_at_the_gaussian_map_of_each_condition(c):
    generator = seeded()
    size = 0.5 + c[:, :1].abs()
    x1 = 3 * c[:, -1:] + size * torch.randn(3000, 2, generator=generator)
    net = PICNN(2, c.shape[1], seed=0).start_at_gaussian(x1, c)
    x0 = torch.randn(3000, 2, generator=generator)
    error = (net.gradient(x0, c) - (3 * c[:, -1:] + size * x0)).square().sum(dim=1).mean()
    assert error < 0.06 * 2 * size.square().mean()


def test_picnn_start_is_reproducible(monkeypatch):
    monkeypatch.setitem(START, "steps", 50)
    x1, c = torch.randn(100, 2), torch.rand(100, 1)
    with pytest.warns(RuntimeWarning, match="x1 has values up to .* too far from 0"):
        PICNN(2, 1, seed=0).start_at_gaussian(300 * x1, c)
    first, second = (PICNN(2, 1, seed=0).start_at_gaussian(x1, c) for _ in range(2))
    assert same_weights(first, second)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype(dtype):
    for net, c in ((ICNN(2), None), (PICNN(2, 2), torch.eye(2, dtype=dtype))):
        x = torch.randn(2, 2, dtype=dtype)
        net = net.to(dtype)
        results = net(x, c), net.gradient(x, c), net.hessian(x, c)
        assert [r.dtype for r in results] == [dtype] * 3
        assert [tuple(r.shape) for r in results] == [(2,), (2, 2), (2, 2, 2)]


def test_seed_and_global_randomness():
    torch.manual_seed(0)
    before = torch.get_rng_state()
    assert torch.equal(ICNN(2, seed=1).body["L"], ICNN(2, seed=1).body["L"])
    assert not torch.equal(ICNN(2, seed=1).body["L"], ICNN(2, seed=2).body["L"])
    assert torch.equal(torch.get_rng_state(), before)


def test_log_sum_exp_has_the_gradient_it_should():
    net, x = LogSumExp(3, seed=1), torch.randn(5, 3)
    net.temperature, net.alpha = 0.7, 0.4
    weights = torch.softmax((x @ net.a.T + net.b) / 0.7, dim=1)
    assert torch.allclose(net.gradient(x), 0.4 * x + weights @ net.a, atol=1e-5)
    assert torch.linalg.eigvalsh(net.hessian(x)).min() > 0.399


X = torch.zeros(4, 2)
C = torch.zeros(4, 1)


test_bad_input = refused(
    (lambda: ICNN(0), ValueError, "dim must be at least 1"),
    (lambda: ICNN(2, width=0), ValueError, "width must be at least 1"),
    (lambda: ICNN(2, depth=0), ValueError, "depth must be at least 1"),
    (lambda: ICNN(2, alpha=1e-3), ValueError, "alpha must be at least 0.01"),
    (lambda: PICNN(2, 0), ValueError, "condition_dim must be at least 1"),
    (lambda: PICNN(2, 1, alpha=math.nan), ValueError, "alpha must be at least 0.01"),
    (lambda: LogSumExp(2, seed=-1), ValueError, "seed must be at least 0"),
    (lambda: ICNN(3).start_at_gaussian(torch.eye(3)), ValueError, "x1 must have more than 3 rows"),
    (lambda: transport(ICNN(2), torch.zeros(4, 3)), ValueError, "x0 has 3 columns, expected 2"),
    (lambda: transport(ICNN(2), X[0]), ValueError, "x0 must have shape"),
    (lambda: transport(ICNN(2), X / 0), ValueError, "x0 has NaN or infinite values in 4 of 4"),
    (lambda: transport(ICNN(2), X.long()), TypeError, "x0 must be a floating-point tensor"),
    (lambda: transport(ICNN(2), X.double()), TypeError, "x0 must have the weights' type"),
    (lambda: transport(ICNN(2), X, C), ValueError, "condition_dim=0, but got c; pass c=None"),
    (lambda: transport(PICNN(2, 1), X), ValueError, r"needs c of shape \(rows, 1\)"),
    (lambda: transport(PICNN(2, 1), X, C[:3]), ValueError, "c has 3 rows, x0 has 4"),
    (lambda: transport(PICNN(2, 1), X, X), ValueError, "c has 2 columns, expected"),
    (lambda: transport(PICNN(2, 1), X, C / 0), ValueError, "c has NaN or infinite values"),
)


def test_an_encoder_of_the_condition_may_learn():
    encoder = nn.Linear(3, 1)
    PICNN(2, 1)(X, encoder(torch.ones(4, 3))).sum().backward()
    assert encoder.weight.grad is not None


def test_inputs_stay_as_they_are():
    x, c = torch.randn(4, 2), torch.randn(4, 1)
    kept = x.clone(), c.clone()
    PICNN(2, 1, seed=0).gradient(x, c)
    assert all(map(torch.equal, (x, c), kept))
