"""Losses of few-step models: the flow of a Gaussian, fixed points, known answers."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import pytest
import torch
from support import refused, seeded
from torch import nn

from cotlearn.couplings import Independent, StratifiedOT
from cotlearn.couplings.base import Pairs
from cotlearn.datasets import Dataset
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.flows.one_step import MeanFlow, MeanVelocity, Shortcut, TwoPasses, jump

MEAN, SPREAD = 3.0, 0.5


def gaussian_pairs(n, seed=0):
    x0, z = torch.randn(2, n, 1, generator=seeded(seed), dtype=torch.float64)
    return Pairs(x0, MEAN + SPREAD * z, None, torch.arange(n), torch.arange(n))


@dataclass
class Exact:
    """The mean velocity from N(0, 1) to N(MEAN, SPREAD^2), off by `error` sin(x) (1 + length)."""

    error: torch.Tensor | float = 0.0

    def __call__(self, t, x, c=None, length=0.0):
        t, length = (torch.as_tensor(v, dtype=x.dtype).expand(len(x))[:, None] for v in (t, length))

        def spread(t):
            return ((1 - t) ** 2 + (t * SPREAD) ** 2).sqrt()

        z = (x - t * MEAN) / spread(t)
        slope = MEAN + (t * SPREAD**2 - (1 - t)) / spread(t) * z
        tiny = length < 1e-9
        some = torch.where(tiny, torch.ones_like(length), length)
        u = MEAN + (spread(t + some) - spread(t)) / some * z
        return torch.where(tiny, slope, u) + self.error * x.sin() * (1 + length)


def slope(loss, error, pairs):
    """Of the mean loss in the error of the mean velocity."""
    error = torch.tensor(error, dtype=torch.float64, requires_grad=True)
    exact = Exact(error)

    def data(t, x, c, length):
        return x + (1 - t[:, None]) * exact(t, x, c, length)

    network = data if getattr(loss, "prediction", "") == "data" else exact
    return torch.autograd.grad(1e6 * loss(network, pairs, seeded()).mean(), error)[0]


@pytest.mark.parametrize("share", [0.0, 0.5])
@pytest.mark.parametrize(
    "kind",
    [MeanFlow, partial(MeanFlow, uniform=True), partial(MeanFlow, prediction="data")],
)
def test_the_mean_velocity_of_a_gaussian_minimises_the_loss_of_mean_flows(monkeypatch, kind, share):
    monkeypatch.setattr("cotlearn.flows.matching.SOFTENING", 1e6)  # equal weights
    loss, pairs = kind(share), gaussian_pairs(100_000)
    assert abs(slope(loss, 0.0, pairs)) < 0.05 < 0.15 < slope(loss, 0.3, pairs)


def test_two_halves_of_an_exact_jump_are_the_jump():
    loss = Shortcut(share=1.0)(Exact(), gaussian_pairs(2000), seeded())
    assert loss.max() < 3e-3  # the smallest halves are velocities
    assert loss.median() < 1e-20
    assert Shortcut(share=1.0)(Exact(0.3), gaussian_pairs(2000), seeded()).mean() > 0.01


def test_without_jumps_both_are_flow_matching_at_length_zero():
    pairs, seen = gaussian_pairs(500), []

    def network(t, x, c, length):
        seen.append(length)
        return Exact()(t, x, c, length)

    Shortcut(share=0.0)(network, pairs, seeded())
    MeanFlow(1.0)(network, pairs, seeded())
    assert all((length == 0).all() for length in seen)


def test_uniform_times_ask_for_jumps_over_nearly_all_of_the_path():
    pairs, long = gaussian_pairs(100_000), {}

    def network(t, x, c, length):
        long[uniform] = float((length > 0.9).double().mean())
        return torch.zeros_like(x)

    for uniform in (True, False):
        MeanFlow(share_instant=0.0, uniform=uniform)(network, pairs, seeded())
    assert long[True] == pytest.approx(0.1**2, rel=0.1)  # both times within a tenth of the ends
    assert long[False] < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("loss", [MeanFlow(), Shortcut(0.25)])
def test_one_jump_of_a_trained_network(loss):
    x1 = MEAN + SPREAD * torch.randn(4000, 1, generator=seeded())
    network = MeanVelocity(VelocityMLP(1, 1, width=64, seed=0))
    data = Dataset(x1)
    found = fit(network, data, Independent(), steps=600, batch_size=128, loss=loss).network
    for nfe in (1, 2, 4):
        drawn = jump(found, torch.randn(4000, 1, generator=seeded(1)), nfe=nfe)
        assert drawn.mean() == pytest.approx(MEAN, abs=0.15)
        assert 0.15 < drawn.std() < 0.65  # one Euler step of a flow has no spread at all
    flow = integrate(found, torch.randn(4000, 1, generator=seeded(1)), nfe=32).x1
    assert flow.std() == pytest.approx(SPREAD, abs=0.2)


@pytest.mark.slow
def test_one_jump_of_a_network_that_predicts_the_data():
    x1 = MEAN + SPREAD * torch.randn(4000, 1, generator=seeded())
    network, loss = VelocityMLP(1, 1, width=64, seed=0), MeanFlow(uniform=True, prediction="data")
    options = {"steps": 600, "batch_size": 128, "loss": loss}
    found = fit(MeanVelocity(network), Dataset(x1), Independent(), **options).network
    drawn = jump(found, torch.randn(4000, 1, generator=seeded(1)), nfe=1, prediction="data")
    assert drawn.mean() == pytest.approx(MEAN, abs=0.15)
    assert 0.15 < drawn.std() < 0.65


def test_every_loss_trains_on_pairs_of_a_conditional_coupling():
    x1, c = torch.randn(2, 512, 2, generator=seeded())
    data, mlp = Dataset(x1, c), VelocityMLP(2, 2, width=16, seed=0)
    for loss, network in (
        (MeanFlow(), MeanVelocity(VelocityMLP(2, 3, width=16, seed=0))),
        (Shortcut(), MeanVelocity(VelocityMLP(2, 3, width=16, seed=0))),
        (TwoPasses(), mlp),
    ):
        found = fit(network, data, StratifiedOT(8), steps=3, batch_size=64, loss=loss)
        assert all(torch.isfinite(p).all() for p in found.network.parameters())


def test_two_passes_see_zeros_and_then_the_first_answer():
    seen = []

    def network(t, x, c):
        seen.append((float(t.reshape(-1)[0]), x))
        return torch.full_like(x, 2.0)

    pairs = replace(gaussian_pairs(5), c=torch.zeros(5, 1))
    expected = 2 * (pairs.x1 - 2).square().sum(dim=1)
    assert torch.allclose(TwoPasses()(network, pairs, seeded()), expected)
    seen.clear()
    assert (TwoPasses().sample(network, pairs.x0, pairs.c) == 2).all()
    assert [time for time, _ in seen] == [0.0, pytest.approx(0.9)]
    assert (seen[0][1] == 0).all()
    assert (seen[1][1] == 1.8).all()


class _NoForwardMode(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return x.clone()

    @staticmethod
    def backward(ctx, grad):
        return grad


class _Opaque(nn.Module):
    dim, condition_dim = 1, 1

    def __init__(self):
        super().__init__()
        self.scale = nn.Parameter(torch.ones(()))

    def forward(self, t, x, c=None):
        return self.scale * _NoForwardMode.apply(x)


@pytest.mark.parametrize("workers", [2, 4])
def test_mean_flow_in_several_threads(workers):
    networks = [MeanVelocity(VelocityMLP(1, 1, width=16, seed=seed)) for seed in range(4)]

    def value(seed):
        pairs = gaussian_pairs(64, seed).map(lambda v: v.float() if v.is_floating_point() else v)
        return MeanFlow(uniform=True)(networks[seed % 4], pairs, seeded(seed)).detach()

    alone = [value(seed) for seed in range(100)]
    with ThreadPoolExecutor(workers) as pool:
        assert all(map(torch.equal, alone, pool.map(value, range(100))))


test_bad_input = refused(
    (lambda: MeanFlow(1.5), "share_instant"),
    (lambda: MeanFlow(prediction="noise"), "prediction"),
    (lambda: Shortcut(-0.1), "share"),
    (lambda: MeanVelocity(VelocityMLP(2)), "condition_dim"),
    (lambda: jump(VelocityMLP(2, 1), torch.zeros(3, 2), nfe=1), "network must be"),
    (lambda: jump(MeanVelocity(VelocityMLP(2, 1)), torch.zeros(3, 2), nfe=0), "nfe"),
    (lambda: jump(MeanVelocity(VelocityMLP(2, 2)), torch.zeros(3, 2), nfe=1), "c is missing"),
    (lambda: MeanFlow()(MeanVelocity(_Opaque()), gaussian_pairs(4), seeded()), "forward-mode"),
    error=(ValueError, TypeError),
)


def test_a_jump_of_the_exact_network_is_the_gaussian(monkeypatch):
    network = MeanVelocity(VelocityMLP(1, 1).double())
    monkeypatch.setattr(MeanVelocity, "forward", lambda self, *args: Exact()(*args))
    x0 = gaussian_pairs(100).x0
    for nfe in (1, 2, 5):
        assert torch.allclose(jump(network, x0, nfe=nfe), MEAN + SPREAD * x0)
    assert math.isclose(float(Exact()(0.0, x0[:1] * 0)), MEAN)


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16, torch.float32])
@pytest.mark.parametrize("loss", [Shortcut(1.0), MeanFlow(0.0, uniform=True)])
def test_no_jump_ends_beyond_the_data(loss, dtype):
    """In half precision a place was rounded up to 1, and a jump of 1 began there."""
    ends = []

    class Mean(nn.Module):
        def forward(self, t, x, c=None, length=0.0):
            ends.append((t + length).double())
            return torch.zeros_like(x)

    index = torch.arange(20_000)
    pairs = Pairs(*torch.randn(2, 20_000, 2, generator=seeded()).to(dtype), None, index, index)
    loss(Mean(), pairs, seeded())
    assert ends[-1].max() <= 1
