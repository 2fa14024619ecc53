import threading

import pytest
import torch
from support import refused, same_weights, seeded

from cotlearn.flows import VelocityMLP
from cotlearn.flows.networks import ImageEncoder, ResidualMLP, SpatialSoftmax


def test_size():
    network = VelocityMLP(2, 4, width=16, depth=3)
    expected = (7 * 16 + 16) + 2 * (16 * 16 + 16) + (16 * 2 + 2)
    assert sum(p.numel() for p in network.parameters()) == expected
    assert (network.dim, network.condition_dim) == (2, 4)


def test_a_seed_gives_the_same_weights_and_leaves_the_global_randomness():
    torch.manual_seed(5)
    first = VelocityMLP(2, seed=1).state_dict()
    after = torch.rand(1)
    torch.manual_seed(5)
    assert torch.equal(after, torch.rand(1))
    again, other = VelocityMLP(2, seed=1).state_dict(), VelocityMLP(2, seed=2).state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert not torch.equal(first["layers.0.weight"], other["layers.0.weight"])
    torch.manual_seed(5)
    free = VelocityMLP(2).state_dict()
    torch.manual_seed(5)
    assert torch.equal(free["layers.0.weight"], VelocityMLP(2).state_dict()["layers.0.weight"])


def test_integer_conditions_are_numbers():
    network = VelocityMLP(2, 3, seed=0)
    x, c = torch.randn(3, 2), torch.eye(3)
    assert torch.equal(network(0.1, x, c.long()), network(0.1, x, c))


def mlp(dim, condition_dim, **options):
    return VelocityMLP(dim, condition_dim, width=8, depth=2, **options)


def residual(dim, condition_dim, **options):
    return ResidualMLP(dim, condition_dim, width=16, blocks=2, context=8, **options)


@pytest.mark.parametrize(
    ("make", "dim", "condition_dim"),
    [(mlp, 1, 0), (mlp, 2, 4), (mlp, 7, 1), (residual, 4, 0), (residual, 8, 3)],
)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_what_every_network_keeps_to(make, dim, condition_dim, dtype):
    network = make(dim, condition_dim, seed=0).to(dtype)
    x = torch.randn(5, dim, dtype=dtype)
    c = torch.randn(5, condition_dim, dtype=dtype) if condition_dim else None
    for t in (0.3, torch.tensor(0.3), torch.full((5,), 0.3), 0):
        v = network(t, x, c)
        assert v.shape == (5, dim)
        assert v.dtype == dtype
    v = network(0.25, x, c)
    one_a_row = network(torch.full((5,), 0.25), x, c)
    assert torch.equal(v, one_a_row) or make is not mlp
    assert torch.allclose(v, one_a_row, atol=1e-6)
    assert not torch.allclose(v, network(0.26, x, c))
    assert not torch.allclose(v, network(0.25, x + 0.5, c))
    if c is not None:
        assert not torch.allclose(v, network(0.25, x, c + 0.5))
    t = torch.rand(5, dtype=dtype)
    swapped = network(t.flip(0), x.flip(0), None if c is None else c.flip(0))  # row by row
    assert torch.allclose(network(t, x, c).flip(0), swapped, atol=1e-6 if make is mlp else 1e-5)
    network(0.5, x, c).sum().backward()
    assert all(p.grad is not None and p.grad.isfinite().all() for p in network.parameters())
    assert same_weights(network, make(dim, condition_dim, seed=0).to(dtype))


def test_the_default_sizes():
    def size(network):
        return sum(p.numel() for p in network.parameters())

    assert size(ResidualMLP(32, 12)) == pytest.approx(1.3e6, rel=0.03)


test_bad_input = refused(
    (lambda: VelocityMLP(0), "dim must be at least 1"),
    (lambda: VelocityMLP(2, -1), "condition_dim must be at least 0"),
    (lambda: VelocityMLP(2, width=0), "width must be at least 1"),
    (lambda: VelocityMLP(2, depth=0), "depth must be at least 1"),
    (lambda: ResidualMLP(2, blocks=0), "blocks must be at least 1"),
    error=ValueError,
)


# --- pictures ----------------------------------------------------------------------------------


def test_spatial_softmax_says_where_a_channel_is_strong():
    h = torch.full((1, 2, 5, 9), -50.0)
    h[0, 0, 1, 8] = 50  # second row, last column
    h[0, 1, 4, 4] = 50
    x0, x1, y0, y1 = SpatialSoftmax()(h)[0].tolist()
    assert (x0, x1, y0, y1) == pytest.approx((1.0, 0.0, -0.5, 1.0), abs=1e-5)
    assert SpatialSoftmax()(torch.zeros(3, 4, 6, 6)).abs().max() < 1e-6  # everywhere: the middle


def test_an_encoder_of_pictures():
    images = torch.rand(3, 3, 32, 32, generator=seeded())
    encoder = ImageEncoder(7, seed=0)
    features = encoder(images)
    assert features.shape == (3, 7)
    assert torch.equal(features, ImageEncoder(7, seed=0)(images))
    assert torch.allclose(features[1:2], encoder(images[1:2]), atol=1e-6)  # no batch statistics
    assert (features - encoder(images.roll(2, dims=3))).abs().max() > 1e-3
    assert ImageEncoder(4)(torch.rand(1, 3, 24, 40)).shape == (1, 4)


def test_seeds_hold_in_several_threads():
    """Of 300 networks with seed=0, 235 had other weights."""
    right, wrong = ResidualMLP(2, width=16, blocks=1, seed=0), []

    def work():
        for _ in range(40):
            wrong.extend(
                [1] * (not same_weights(ResidualMLP(2, width=16, blocks=1, seed=0), right))
            )
            torch.rand(3)

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


@pytest.mark.parametrize("make", [ResidualMLP, VelocityMLP])
def test_a_seed_gives_torchs_weights_and_leaves_its_randomness_alone(make):
    before = torch.get_rng_state()
    seeded_one = make(3, 2, width=8, seed=7)
    assert torch.equal(torch.get_rng_state(), before)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(7)
        assert same_weights(make(3, 2, width=8), seeded_one)
