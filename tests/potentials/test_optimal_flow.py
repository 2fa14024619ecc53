"""Optimal flow matching against closed forms, finite differences, and its own dual (I3 is in
test_action)."""

import numpy as np
import pytest
import torch
from small import make_pairs, network
from support import refused, same_weights, seeded
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT, Pairs
from cotlearn.flows import conditional_flow_matching_loss, fit, integrate, sampler, training
from cotlearn.gaussian import bures_squared
from cotlearn.metrics import conditional_squared_w2, l2_uvp
from cotlearn.mixtures import petals
from cotlearn.potentials import ICNN, PICNN, OptimalField, dual_loss, dual_objective, transport
from cotlearn.potentials.inversion import InversionWarning, invert
from cotlearn.potentials.optimal_flow import (
    optimal_flow_matching_loss,
    optimal_flow_matching_loss_at,
)
from cotlearn.potentials.truth import ConditionalGaussian, KnownMap, LogSumExp

SHUFFLED = torch.randperm(64, generator=seeded(5))
ROOT = torch.tensor([[1.5, 0.4], [0.4, 0.6]], dtype=torch.float64)
MEAN = torch.tensor([2.0, -1.0], dtype=torch.float64)


def gaussian_potential():
    """The potential of the optimal map x -> ROOT x + MEAN, without a network's part."""
    net = ICNN(2, width=1, depth=1).double()
    with torch.no_grad():
        net.body["raw_w"].fill_(-100.0)
        net.root.copy_(torch.linalg.cholesky(ROOT - net.alpha * torch.eye(2).double()))
        net.b.copy_(MEAN)
    return net


def gauss_legendre(f, nodes=48):
    """The integral of f over [0, 1]."""
    places, weights = np.polynomial.legendre.leggauss(nodes)
    return sum(w / 2 * f((p + 1) / 2) for p, w in zip(places, weights, strict=True))


# --- the Gaussian closed form ---------------------------------------------------------------------


def test_transport_and_its_inverse_are_the_gaussian_map():
    x0 = make_pairs().x0
    x1 = transport(gaussian_potential(), x0)
    assert torch.allclose(x1, x0 @ ROOT + MEAN)
    assert torch.allclose(invert(gaussian_potential(), x1).z, x0)


@pytest.mark.parametrize("t", [0.0, 0.3, 1.0])
def test_field_is_the_displacement_interpolation(t):
    x0 = make_pairs().x0
    x1 = x0 @ ROOT + MEAN
    field = OptimalField(gaussian_potential())
    assert torch.allclose(field(t, (1 - t) * x0 + t * x1), x1 - x0, atol=1e-8)


def test_one_euler_step_is_exact():
    net, x0 = network(), make_pairs().x0
    field = OptimalField(net)
    for nfe in (1, 7):
        assert torch.allclose(integrate(field, x0, nfe=nfe).x1, transport(net, x0), atol=1e-7)


@pytest.mark.slow
def test_loss_is_zero_for_optimal_pairs_and_else_the_floor():
    """The floor E|x1 - x0|^2 - W2^2, here in closed form for independent pairs."""
    net = gaussian_potential()
    x0 = torch.randn(10_000, 2, generator=seeded()).double()
    rows = torch.arange(len(x0))
    optimal = Pairs(x0, x0 @ ROOT + MEAN, None, rows, rows)
    generator = seeded(1)
    for loss in (optimal_flow_matching_loss, dual_loss):
        assert loss(net, optimal, generator).abs().max() < 1e-6
        fresh = torch.randn(x0.shape, generator=seeded(2)).double()
        values = loss(net, Pairs(fresh, optimal.x1, None, rows, rows), generator).detach()
        S = (ROOT @ ROOT).numpy()
        means = float(MEAN @ MEAN)
        floor = (np.trace(S) + 2 + means) - (bures_squared(np.eye(2), S) + means)
        error = float(values.std()) / len(values) ** 0.5
        assert abs(float(values.mean()) - floor) < 4 * error
        assert error < 0.05 * floor


def test_floor_with_a_known_map():
    data = KnownMap(LogSumExp(3, seed=2).gradient, 3)
    generator = seeded()
    x0, other = torch.randn(2, 4000, 3, generator=generator)
    x1, rows = data.transport(other), torch.arange(4000)
    pairs = Pairs(x0, x1, None, rows, rows)
    values = optimal_flow_matching_loss(LogSumExp(3, seed=2), pairs, generator)
    squared_w2 = (data.transport(x0) - x0).square().sum(dim=1)
    floor = (x1 - x0).square().sum(dim=1) - squared_w2
    gap = (values - floor).detach()
    assert abs(float(gap.mean())) < 4 * float(gap.std()) / 4000**0.5
    assert floor.mean() > 1


# --- I1: the loss is twice the dual, whatever the plan --------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("condition_dim", [0, 2])
def test_i1_for_two_plans(condition_dim):
    net = network(condition_dim)
    values = []
    with torch.no_grad():
        for order in (None, None if condition_dim else SHUFFLED):
            pairs = make_pairs(order=order, condition_dim=condition_dim)
            left = gauss_legendre(lambda t, p=pairs: optimal_flow_matching_loss_at(net, p, t))
            dual = dual_objective(net, pairs.x0, pairs.x1, pairs.c)
            right = 2 * dual - 2 * (pairs.x0 * pairs.x1).sum(dim=1)
            assert torch.allclose(left, right, atol=1e-6)  # even pair by pair
            assert torch.allclose(dual_loss(net, pairs), right, atol=1e-9)
            values.append(float(left.mean() + 2 * (pairs.x0 * pairs.x1).sum(dim=1).mean()))
    assert values[0] == pytest.approx(values[1], abs=1e-6)


def test_dual_loss_of_a_batch_has_the_same_gradient_for_every_plan():
    found = [gradient(dual_loss, network(), make_pairs(order=order)) for order in (None, SHUFFLED)]
    assert torch.allclose(*found, atol=1e-7)


def gradient(loss, net, pairs, *arguments):
    """Of the mean loss, in all parameters."""
    value = loss(net, pairs, *arguments).mean()
    return torch.cat([g.flatten() for g in torch.autograd.grad(value, list(net.parameters()))])


@pytest.mark.parametrize("order", [None, SHUFFLED], ids=["same", "shuffled"])
def test_proxy_gradient_is_twice_the_gradient_of_the_dual(order):
    net, pairs = network(), make_pairs(order=order)
    integrated = gauss_legendre(lambda t: gradient(optimal_flow_matching_loss_at, net, pairs, t))
    dual = gradient(lambda net, pairs: dual_objective(net, pairs.x0, pairs.x1), net, pairs)
    assert torch.allclose(integrated, 2 * dual, atol=1e-6)
    assert dual.norm() > 0.1


@pytest.mark.parametrize("condition_dim", [0, 2])
@pytest.mark.parametrize("t", [0.0, 0.4, 1.0, "random"])
def test_proxy_gradient_against_finite_differences(t, condition_dim):
    net, pairs = network(condition_dim), make_pairs(condition_dim=condition_dim)
    if t == "random":
        t = torch.rand(64, generator=seeded(3)).double()
    found = gradient(optimal_flow_matching_loss_at, net, pairs, t)
    start = parameters_to_vector(net.parameters()).detach()
    generator = seeded()
    for _ in range(4):
        way = torch.randn(start.shape, generator=generator).double()
        sides = []
        for h in (1e-5, -1e-5):
            vector_to_parameters(start + h * way, net.parameters())
            sides.append(float(optimal_flow_matching_loss_at(net, pairs, t).mean().detach()))
        vector_to_parameters(start, net.parameters())
        assert (sides[0] - sides[1]) / 2e-5 == pytest.approx(float(found @ way), rel=1e-4, abs=1e-5)


def test_proxy_gradient_by_conjugate_gradients(monkeypatch):
    net, pairs = network(), make_pairs()
    exact = gradient(optimal_flow_matching_loss_at, net, pairs, 0.7)
    monkeypatch.setattr("cotlearn.potentials.inversion.EXPLICIT", 1)
    found = gradient(optimal_flow_matching_loss_at, net, pairs, 0.7)
    assert torch.allclose(found, exact, rtol=1e-3, atol=1e-4)


def test_losses_draw_t_from_their_generator():
    net, pairs = network(), make_pairs()
    first, second, third = (optimal_flow_matching_loss(net, pairs, seeded(s)) for s in (1, 1, 2))
    assert torch.equal(first, second)
    assert not torch.equal(first, third)
    assert torch.equal(dual_loss(net, pairs), dual_loss(net, pairs))


def test_dtype():
    net, pairs = network(), make_pairs()
    assert optimal_flow_matching_loss(net, pairs).dtype == torch.float64
    small = pairs.map(lambda v: v.float() if v.is_floating_point() else v)
    for loss in (optimal_flow_matching_loss, dual_loss):
        assert loss(net.float(), small).dtype == torch.float32


# --- training -------------------------------------------------------------------------------------

TRAINING = {"steps": 200, "batch_size": 128, "learning_rate": 3e-2, "seed": 0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loss", "coupling"),
    [
        (optimal_flow_matching_loss, Independent()),
        (optimal_flow_matching_loss, MinibatchOT()),
        (dual_loss, Independent()),  # the same for every plan, see the test of its gradient
    ],
)
def test_training_finds_a_known_map(loss, coupling):
    data = KnownMap(LogSumExp(2, seed=0).gradient, 2)
    net = ICNN(2, width=32, depth=2, seed=0).start_at_gaussian(data.sample(2000)[0])
    x0 = torch.randn(2000, 2, generator=seeded(9))
    before = l2_uvp(transport(net, x0), data.transport(x0))
    options = {**TRAINING, "steps": 300}
    trained = fit(net, data, coupling, loss=loss, **options).network
    assert l2_uvp(transport(trained, x0), data.transport(x0)) < 2 < 8 < before


@pytest.mark.slow
def test_naive_pairs_with_a_condition_change_the_answer():
    """Plan-independence protects only while the noise does not depend on the condition."""
    data = ConditionalGaussian(2)
    generator = seeded()
    net = PICNN(2, 1, width=16, depth=1, seed=0).start_at_gaussian(*data.sample(2000, generator))
    c = data.sample_conditions(1000, generator)
    x0 = torch.randn(1000, 2, generator=generator)
    found = {}
    for coupling in (Independent(), MinibatchOT(), ConditionalOT(1e4)):
        options = {**TRAINING, "steps": 100, "learning_rate": 1e-2}
        trained = fit(net, data, coupling, loss=dual_loss, **options).network
        made = transport(trained, x0, c)
        found[coupling.name] = l2_uvp(made, data.transport(x0, c), variance=data.variance())
    assert found["independent"] < 3
    assert found["conditional_ot"] < 10
    assert found["minibatch_ot"] > 50


@pytest.mark.parametrize("loss", [optimal_flow_matching_loss, dual_loss])
def test_resumes_bit_for_bit(loss, tmp_path, monkeypatch):
    data = petals()
    options = {"batch_size": 16, "loss": loss, "coupling": MinibatchOT(), "schedule": "constant"}
    net = PICNN(2, 4, width=8, depth=1, seed=0)
    whole = fit(net, data, steps=12, **options).network
    path = tmp_path / "part.safetensors"

    class Stopped(Exception):
        pass

    class Stops:
        def __init__(self):
            self.calls, self.__qualname__ = 0, loss.__qualname__  # a checkpoint asks for the name

        def __call__(self, network, pairs, generator):
            self.calls += 1
            if self.calls == 8:
                raise Stopped
            return loss(network, pairs, generator)

    monkeypatch.setattr(training, "CHECKPOINT_EVERY", 6)
    part = {"steps": 12, "checkpoint": path}
    with pytest.raises(Stopped):
        fit(net, data, **{**options, "loss": Stops()}, **part)
    assert same_weights(whole, fit(net, data, **options, **part).network)


@pytest.mark.slow
def test_sampling_through_the_field():
    data = petals()
    net = PICNN(2, 4, seed=0).start_at_gaussian(*data.sample(2000, seeded()))
    assert conditional_squared_w2(sampler(OptimalField(net), nfe=1), data, n=200) < 2


# --- bad input ------------------------------------------------------------------------------------


def train(net, data, **options):
    fit(net, data, Independent(), batch_size=8, loss=dual_loss, **options)


test_data_that_do_not_fit = refused(
    (lambda: train(ICNN(3), petals(), steps=1), "x1 has 2 columns, expected 3"),
    (lambda: train(ICNN(2), petals(), steps=1), "condition_dim=0, but got c"),
    (lambda: train(PICNN(2, 3), petals(), steps=1), "c has 4 columns, expected 3"),
    error=ValueError,
)


@pytest.mark.parametrize("t", [-0.01, 1.01, float("nan"), torch.full((64,), 2.0)])
def test_times_outside_the_interval(t):
    with pytest.raises(ValueError, match=r"t must lie in \[0, 1\]"):
        OptimalField(network())(t, make_pairs().x0)
    with pytest.raises(ValueError, match=r"t must lie in \[0, 1\]"):
        optimal_flow_matching_loss_at(network(), make_pairs(), t)


def test_training_that_diverges_says_so():
    data = KnownMap(LogSumExp(2, seed=0).gradient, 2)
    with pytest.raises(RuntimeError, match=r"not finite|became"):
        train(ICNN(2, width=4, seed=0), data, steps=50, learning_rate=1e30)


def test_rows_that_do_not_converge_are_told(monkeypatch):
    monkeypatch.setattr("cotlearn.potentials.inversion.TOLERANCE", {torch.float64: 1e-300})
    with pytest.warns(InversionWarning, match="rows did not converge"):
        dual_loss(network(), make_pairs())


def test_a_velocity_loss_is_no_loss_for_a_potential():
    with pytest.raises((TypeError, ValueError)):
        conditional_flow_matching_loss(network(), make_pairs())
