"""The known maps are transport maps, and optimal ones."""

import math

import pytest
import torch
from support import refused, seeded

from cotlearn.datasets import unconditional
from cotlearn.metrics import squared_w2
from cotlearn.mixtures import eight_gaussians
from cotlearn.potentials import ConditionalGaussian, KnownMap, LogSumExp, eight_gaussians_map


@pytest.mark.parametrize("dim", [1, 2, 5])
def test_conditional_gaussian_has_its_moments(dim):
    data = ConditionalGaussian(dim)
    c = torch.full((20_000, 1), 0.3)
    x1 = data.sample_given(c, seeded())
    mean, root = data.moments(c[:1])
    assert torch.allclose(root, root.mT)
    assert torch.linalg.eigvalsh(root).min() > 0.29
    assert (x1.mean(dim=0) - mean[0]).abs().max() < 0.04
    assert (torch.cov(x1.T) - root[0] @ root[0]).abs().max() < 0.05
    assert data.variance() == pytest.approx(float((root[0] @ root[0]).trace()), rel=1e-5)
    assert data.conditions(4).tolist() == [[-0.75], [-0.25], [0.25], [0.75]]


def test_gaussian_map_is_symmetric_and_positive():
    data = KnownMap.gaussian(4, seed=3)
    zero, steps = torch.zeros(1, 4), torch.eye(4)
    slope = data.transport(steps) - data.transport(zero)
    assert torch.allclose(slope, slope.T, atol=1e-5)
    assert torch.linalg.eigvalsh(slope).min() == pytest.approx(0.3, rel=1e-4)
    assert torch.equal(data.sample(5, seeded())[0], data.sample(5, seeded())[0])
    assert data.sample(5)[1] is None


def test_map_to_eight_gaussians():
    x0, x1 = eight_gaussians_map(256)
    assert x0.shape == x1.shape == (4096, 2)
    assert torch.allclose(torch.cov(x0.T), torch.eye(2), atol=0.02)
    centre = torch.cdist(x1, eight_gaussians().conditions() @ _centres()).argmin(dim=1)
    assert torch.equal(centre.bincount(), torch.full((8,), 512))
    spread = x1 - _centres()[centre]
    assert torch.allclose(torch.cov(spread.T), 0.1 * torch.eye(2), atol=0.005)
    # No other pairing of these points is cheaper: the map is optimal for them.
    some = torch.randperm(4096, generator=seeded())[:800]
    cost = (x0 - x1)[some].square().sum(dim=1).mean()
    assert squared_w2(x0[some], x1[some]) == pytest.approx(float(cost), rel=1e-3)


def test_map_to_eight_gaussians_has_the_known_cost():
    x0, x1 = eight_gaussians_map(512)
    data = unconditional(eight_gaussians())
    exact = float((x0 - x1).square().sum(dim=1).mean())
    noise = torch.randn(2000, 2, generator=seeded())
    sampled = squared_w2(noise, data.sample(2000, generator=seeded(1))[0])
    assert sampled == pytest.approx(exact, rel=0.03)


def _centres():
    angle = 2 * math.pi * torch.arange(8) / 8
    return 5 * torch.stack([angle.cos(), angle.sin()], dim=1)


DATA, X0 = KnownMap(LogSumExp(2).gradient, 2), torch.zeros(3, 2)
test_bad_input = refused(
    (lambda: eight_gaussians_map(100), "n must be a power of 2, got 100"),
    (lambda: ConditionalGaussian(0), "dim must be at least 1"),
    (lambda: DATA.transport(X0, torch.zeros(3, 1)), "condition_dim=0, but got c"),
    (lambda: DATA.transport(torch.zeros(3, 3)), "x0 has 3 columns, expected 2"),
    (lambda: ConditionalGaussian().transport(X0, torch.zeros(2, 1)), "c has 2 rows, x0 has 3"),
    error=ValueError,
)
