import pytest
import torch
from support import seeded

from cotlearn.couplings import Independent, Pairs
from cotlearn.flows import FlowMatching, VelocityMLP, flow_matching_step, integrate, velocity_of
from cotlearn.flows.diffusion import Diffusion
from cotlearn.flows.matching import conditional_flow_matching_loss, interpolate, weighted_mean
from cotlearn.flows.one_step import MeanFlow, MeanVelocity, Shortcut
from cotlearn.mixtures import petals


def pairs(n=6, weight=None):
    x1, c = petals().sample(n, generator=seeded())
    x0 = torch.randn(n, 2, generator=seeded(1))
    rows = torch.arange(n)
    return Pairs(x0, x1, c, rows, rows, weight)


def test_the_straight_path():
    x0, x1 = torch.randn(3, 2), torch.randn(3, 2)
    t = torch.tensor([0.0, 0.25, 1.0])
    x_t = interpolate(x0, x1, t)
    assert torch.equal(x_t[0], x0[0])
    assert torch.allclose(x_t[1], 0.75 * x0[1] + 0.25 * x1[1])
    assert torch.equal(x_t[2], x1[2])


def test_the_loss_is_the_squared_error_of_each_row():
    batch = pairs()
    seen = {}

    def network(t, x, c):
        seen.update(t=t, x=x, c=c)
        return torch.ones_like(x)

    losses = conditional_flow_matching_loss(network, batch, seeded(3))
    assert torch.allclose(losses, (1 - (batch.x1 - batch.x0)).square().sum(dim=1))
    assert torch.equal(seen["t"], torch.rand(6, generator=seeded(3)))
    assert torch.equal(seen["x"], interpolate(batch.x0, batch.x1, seen["t"]))
    assert torch.equal(seen["c"], batch.c)


def test_the_true_velocity_of_each_pair_has_no_loss():
    batch = pairs()
    losses = conditional_flow_matching_loss(lambda t, x, c: batch.x1 - batch.x0, batch)
    assert torch.equal(losses, torch.zeros(6))


def test_the_closed_form_velocity_is_the_best_for_independent_pairs():
    data, batch = petals(), pairs(4000)

    def loss(scale):
        field = lambda t, x, c: scale * data.velocity(t, x, c)  # noqa: E731
        return conditional_flow_matching_loss(field, batch, seeded(2)).mean()

    assert loss(1.0) < loss(0.95)
    assert loss(1.0) < loss(1.05)


def test_a_network_whose_output_would_broadcast_is_refused():
    for wrong in (torch.zeros(6, 1), torch.zeros(1, 2), torch.zeros(2), torch.zeros(6, 2, 1)):
        with pytest.raises(ValueError, match=r"network must return shape \(6, 2\), got"):
            conditional_flow_matching_loss(lambda t, x, c, wrong=wrong: wrong, pairs())


def test_the_mean_takes_weights():
    weight = torch.tensor([2.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    losses = torch.arange(6.0)
    assert weighted_mean(losses, pairs()) == 2.5
    assert weighted_mean(losses, pairs(weight=weight)) == pytest.approx(14 / 6)


def test_a_step_is_the_mean_loss():
    network, batch = VelocityMLP(2, 4, width=8, depth=1, seed=0), pairs(50)
    loss = flow_matching_step(network, batch, seeded(3))
    assert loss == conditional_flow_matching_loss(network, batch, seeded(3)).mean()
    loss.backward()
    assert all(p.grad is not None for p in network.parameters())


@pytest.mark.parametrize("t", [torch.zeros(5), torch.zeros(6, 1), torch.zeros(())])
def test_times_that_would_broadcast_are_refused(t):
    with pytest.raises(ValueError, match=r"t must have shape \(6,\), got"):
        interpolate(torch.zeros(6, 2), torch.zeros(6, 2), t)


@pytest.mark.parametrize("shape", [(), (1,), (6, 1), (5,)])
def test_a_loss_of_another_shape_is_refused(shape):
    with pytest.raises(ValueError, match=r"loss must return one value per row, shape \(6,\)"):
        weighted_mean(torch.zeros(shape), pairs())


def test_oversampling_trains_a_share_of_the_rows_at_t_0():
    batch, seen = pairs(n=4000), []

    def network(t, x, c):
        seen.append(t)
        return torch.zeros_like(x)

    losses = FlowMatching(0.3)(network, batch, seeded(0))
    assert torch.allclose(losses, (batch.x1 - batch.x0).square().sum(dim=1))
    assert float((seen[0] == 0).float().mean()) == pytest.approx(0.3, abs=0.04)
    assert float(seen[0][seen[0] > 0].mean()) == pytest.approx(0.5, abs=0.03)
    with pytest.raises(ValueError, match=r"share_at_t0 must lie in \[0, 1\], got 1.5"):
        FlowMatching(1.5)


def exact_data(t, x, c):
    """E[x1 | x_t] for independent pairs and x1 ~ N(m, s^2 I)."""
    t = t.reshape(-1, 1)
    gain = t * DEVIATION**2 / ((1 - t) ** 2 + t**2 * DEVIATION**2)
    return MEAN + gain * (x - t * MEAN)


MEAN, DEVIATION = 0.7, 0.4


def test_a_network_that_predicts_the_data_stands_for_the_same_field():
    x0 = torch.randn(50, 2, generator=seeded(0), dtype=torch.float64)
    field = velocity_of(exact_data, "data")
    moved = integrate(field, x0, nfe=1000).x1
    assert torch.allclose(moved, MEAN + DEVIATION * x0, atol=0.005)  # the map between Gaussians
    assert torch.allclose(integrate(field, x0, nfe=1).x1, torch.full_like(x0, MEAN))
    assert velocity_of(exact_data) is exact_data
    with pytest.raises(ValueError, match="prediction must be one of velocity, data"):
        velocity_of(exact_data, "noise")


def test_its_loss_weighs_the_error_of_the_velocity_by_the_time_that_is_left():
    batch, times = pairs(n=200), []

    def velocity(t, x, c):
        times.append(t)
        return torch.zeros_like(x)

    def data(t, x, c):  # stands for the same field
        return x

    plain = conditional_flow_matching_loss(velocity, batch, seeded(1))
    weighed = FlowMatching(prediction="data")(data, batch, seeded(1))
    assert torch.allclose(weighed, plain * (1 - times[0]) ** 2, rtol=1e-3, atol=1e-5)
    with pytest.raises(ValueError, match="prediction must be one of velocity, data; got 'x1'"):
        FlowMatching(prediction="x1")


def test_adaptive_weights_descend_the_logarithm_of_the_squared_error():
    """With power 1 the gradient is that of log(e + 0.01), whose least value is near one answer."""
    answer = torch.tensor([[0.0]] * 7 + [[4.0]] * 3, dtype=torch.float64)
    index = torch.arange(10)
    batch = Pairs(torch.zeros_like(answer), answer, None, index, index)
    said = torch.linspace(-1, 5, 601, dtype=torch.float64, requires_grad=True)

    def slopes(power):
        loss = FlowMatching(1.0, power=power)

        def at(m):
            return loss(lambda t, x, c: m.expand_as(x), batch, seeded(0)).sum()

        return torch.autograd.grad(sum(at(m) for m in said), said)[0]

    objective = ((answer - said).square() + 0.01).log().sum(dim=0)
    assert torch.allclose(slopes(1.0), torch.autograd.grad(objective.sum(), said)[0])
    assert abs(float(said[objective.argmin()].detach())) < 0.02  # the more frequent answer
    assert float(said[slopes(0.0).abs().argmin()].detach()) == pytest.approx(1.2)  # the mean
    with pytest.raises(TypeError, match="power must be a number, got 'big'"):
        FlowMatching(power="big")


@pytest.mark.parametrize("loss", [FlowMatching(), MeanFlow(), Shortcut(), Diffusion().loss])
def test_noise_and_data_of_different_types(loss):
    network = MeanVelocity(VelocityMLP(2, 1, width=8))
    x0, x1 = torch.randn(2, 5, 2)
    pairs = Independent()(x0, x1.double())
    with pytest.raises(TypeError, match=r"x1 must have x0's type torch.float32, got torch.float64"):
        loss(network, pairs, torch.Generator())
