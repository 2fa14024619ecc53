"""The solvers on equations whose solution is known."""

import math
from functools import partial

import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import Reflow
from cotlearn.flows import Guided, VelocityMLP, integrate, sampler, solvers, velocity_of
from cotlearn.flows.diffusion import Diffusion
from cotlearn.flows.one_step import Drifting, MeanVelocity, TwoPasses, jump
from cotlearn.flows.solvers import METHODS
from cotlearn.gaussian import LinearGaussian
from cotlearn.metrics import squared_w2, straightness
from cotlearn.mixtures import petals

NETWORK = VelocityMLP(2, 4, width=8, depth=1).double()
FIXED = {"euler": (1, 1), "midpoint": (2, 2), "heun": (2, 2), "rk4": (4, 4)}  # evaluations, order


def known(t, x, c):
    """dx/dt = x cos(3 t) + c, a linear equation in t and x."""
    return x * torch.cos(3 * t) + (0 if c is None else c)


def known_solution(x0):
    return x0 * math.exp(math.sin(3) / 3)


class Counting:
    def __init__(self, velocity=known):
        self.velocity, self.calls, self.times = velocity, 0, []

    def __call__(self, t, x, c):
        self.calls += 1
        self.times.append(float(t))
        return self.velocity(t, x, c)


def start(n=5):
    return torch.randn(n, 2, generator=seeded(), dtype=torch.float64)


@pytest.mark.parametrize("method", FIXED)
def test_order_of_convergence(method):
    """On dx/dt = -(1 + t) x^2, with 1 / x(1) = 1 / x(0) + 3/2."""
    per_step, order = FIXED[method]
    x0 = 0.5 + torch.rand(5, 2, generator=seeded(), dtype=torch.float64)
    errors = []
    for steps in (32, 64, 128):
        x1 = integrate(lambda t, x, c: -(1 + t) * x**2, x0, nfe=steps * per_step, method=method).x1
        errors.append(float((x1 - 1 / (1 / x0 + 1.5)).abs().max()))
    for coarse, fine in zip(errors, errors[1:]):  # noqa: B905, RUF007
        assert math.log2(coarse / fine) == pytest.approx(order, abs=0.15)


def curved(nfe, method):
    """Along the velocity of a mixture."""
    x0, c = 0.7 * start(), torch.eye(4, dtype=torch.float64)[[0, 1, 2, 3, 0]]
    return integrate(petals().velocity, x0, c, nfe=nfe, method=method).x1


@pytest.fixture(scope="module")
def exact():
    return curved(4000, "rk4")


@pytest.mark.slow
@pytest.mark.parametrize("method", FIXED)
def test_order_of_convergence_of_a_curved_field(method, exact):
    """The velocity of a mixture: nonlinear in x, so that a wrong stage cannot hide."""
    per_step, order = FIXED[method]
    errors = [float((curved(n * per_step, method) - exact).abs().max()) for n in (100, 200)]
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.35)


@pytest.mark.parametrize("method", FIXED)
def test_evaluations_are_counted(method):
    per_step, _ = FIXED[method]
    velocity = Counting()
    solution = integrate(velocity, start(), nfe=3 * per_step, method=method)
    assert solution.nfe == velocity.calls == 3 * per_step
    assert all(0 <= t <= 1 for t in velocity.times)
    assert solution.trajectory is None
    assert solution.times[-1] == 1


def test_evaluations_of_dopri5_are_counted():
    velocity = Counting()
    assert integrate(velocity, start(), method="dopri5").nfe == velocity.calls > 6


@pytest.mark.parametrize("tolerance", [1e-3, 1e-6, 1e-9])
def test_dopri5_keeps_its_tolerance(monkeypatch, tolerance):
    monkeypatch.setattr("cotlearn.flows.solvers.TOLERANCE", tolerance)
    x0 = start()
    solution = integrate(known, x0, method="dopri5")
    assert (solution.x1 - known_solution(x0)).abs().max() < 20 * tolerance


@pytest.mark.parametrize("method", [*FIXED, "dopri5"])
def test_a_straight_field_is_exact_in_one_step(method):
    x0 = start()
    nfe = FIXED[method][0] if method in FIXED else None
    shift = torch.tensor([1.0, -2.0], dtype=torch.float64)
    x1 = integrate(lambda t, x, c: shift.expand_as(x), x0, nfe=nfe, method=method).x1
    assert torch.allclose(x1, x0 + shift)


@pytest.mark.parametrize("method", [*FIXED, "dopri5"])
def test_trajectory(method):
    x0 = start()
    nfe = 3 * FIXED[method][0] if method in FIXED else None
    solution = integrate(known, x0, nfe=nfe, method=method, trajectory=True)
    T = len(solution.times)
    assert solution.trajectory.shape == (T, 5, 2)
    assert torch.equal(solution.trajectory[0], x0)
    assert torch.equal(solution.trajectory[-1], solution.x1)
    assert (solution.times[0], solution.times[-1]) == (0, 1)
    assert (solution.times.diff() > 0).all()
    if method in FIXED:
        assert T == 4
    assert torch.equal(integrate(known, x0, nfe=nfe, method=method).x1, solution.x1)


@pytest.mark.parametrize("method", [*FIXED, "dopri5"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_dtype_condition_and_inputs(method, dtype):
    x0 = start().to(dtype)
    c = torch.full((5, 1), 2.0, dtype=dtype)
    before = x0.clone(), c.clone()
    nfe = 8 if method in FIXED else None
    solution = integrate(known, x0, c, nfe=nfe, method=method)
    assert solution.x1.dtype == dtype
    assert all(map(torch.equal, (x0, c), before))
    assert not torch.allclose(solution.x1, integrate(known, x0, nfe=nfe, method=method).x1)


def test_no_gradient_is_kept():
    assert not integrate(VelocityMLP(2, seed=0), torch.zeros(3, 2), nfe=2).x1.requires_grad


def test_euler_on_the_exactly_solvable_case():
    flow = LinearGaussian.example().flow("independent")

    def velocity(t, x, c):
        return torch.from_numpy(flow.velocity(float(t), x.numpy(), c.numpy()))

    n = 20_000
    noise = torch.randn(n, 2, generator=seeded(), dtype=torch.float64)
    x = integrate(velocity, noise, torch.full((n, 1), 0.8, dtype=torch.float64), nfe=4).x1
    mean, covariance = flow.law_after([0.8], nfe=4)
    assert torch.allclose(x.mean(dim=0), torch.from_numpy(mean), atol=0.03)
    assert torch.allclose(x.T.cov(), torch.from_numpy(covariance), atol=0.03)


BLIND, C = VelocityMLP(2).double(), torch.zeros(5, 3)
test_bad_input = refused(
    ({}, ValueError, "nfe is missing"),
    ({"nfe": 0}, ValueError, "nfe must be at least 1"),
    ({"nfe": -2}, ValueError, "nfe must be at least 1"),
    ({"nfe": 2.0}, TypeError, "nfe must be an integer"),
    ({"nfe": True}, TypeError, "nfe must be an integer"),
    ({"nfe": 3, "method": "midpoint"}, ValueError, "nfe must be divisible by 2 for midpoint"),
    ({"nfe": 5, "method": "heun"}, ValueError, "nfe must be divisible by 2 for heun, got 5"),
    ({"nfe": 6, "method": "rk4"}, ValueError, "nfe must be divisible by 4 for rk4, got 6"),
    ({"nfe": 4, "method": "rk45"}, ValueError, "method must be one of euler, midpoint, heun"),
    ({"nfe": 4, "method": "dopri5"}, ValueError, "nfe must be None for dopri5"),
    ({"nfe": 1, "x0": torch.zeros(2)}, ValueError, r"x0 must have shape"),
    ({"nfe": 1, "x0": torch.zeros(0, 2)}, ValueError, "x0 is empty"),
    ({"nfe": 1, "x0": torch.full((1, 2), math.nan)}, ValueError, "x0 has NaN"),
    ({"nfe": 1, "x0": [[0.0]]}, TypeError, "x0 must be a torch tensor"),
    ({"nfe": 1, "c": torch.zeros(4, 1)}, ValueError, "c has 4 rows, x0 has 5"),
    ({"nfe": 1, "c": torch.zeros(5)}, ValueError, "c must have shape"),
    ({"nfe": 1, "velocity": VelocityMLP(2, 4)}, TypeError, "x0 must have the weights' type"),
    ({"nfe": 1, "velocity": NETWORK}, ValueError, r"c is missing: .* \(rows, 4\)"),
    ({"nfe": 1, "velocity": NETWORK, "c": C}, ValueError, "c has 3 columns, expected 4"),
    ({"nfe": 1, "velocity": VelocityMLP(3).double()}, ValueError, "x0 has 2 columns, expected"),
    ({"nfe": 1, "velocity": BLIND, "c": C}, ValueError, "condition_dim=0, but got c"),
    ({"nfe": 1, "velocity": lambda t, x, c: x[:2]}, ValueError, "velocity must return shape"),
    ({"nfe": 1, "velocity": lambda t, x, c: 0.0}, TypeError, "velocity must .* got float"),
    ({"method": "dopri5", "velocity": lambda t, x, c: x * math.nan}, RuntimeError, "dopri5"),
    of=lambda **options: integrate(**{"velocity": known, "x0": start(), **options}),
)


def test_sampler_draws_fresh_noise_for_each_row():
    data = petals()
    c = data.conditions().repeat_interleave(300, dim=0)
    draw = sampler(data.velocity, nfe=80, dim=2)
    x = draw(c, generator=seeded())
    assert x.shape == (1200, 2)
    assert torch.equal(x, draw(c, generator=seeded()))
    assert not torch.equal(x, draw(c, generator=seeded(1)))
    for k in range(4):
        rows = c[:, k] == 1
        assert squared_w2(x[rows], data.sample_given(c[rows], generator=seeded(2))) < 0.3


def test_sampler_knows_the_dimension_of_a_network():
    assert sampler(VelocityMLP(3, 4), nfe=1)(torch.eye(4)).shape == (4, 3)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16])
@pytest.mark.parametrize(("method", "nfe"), [("euler", 2000), ("midpoint", 1000), ("rk4", 400)])
def test_small_steps_are_not_rounded_away(dtype, method, nfe):
    x0 = torch.ones(4, 2, dtype=dtype)
    found = integrate(lambda t, x, c: torch.ones_like(x), x0, nfe=nfe, method=method)
    assert found.x1.dtype == dtype
    assert (found.x1 == 2).all()


def test_a_sampler_starts_from_the_noise_of_the_training():
    def far(n, generator=None):
        return 100 + torch.randn(n, 2, generator=generator)

    def still(t, x, c):
        return torch.zeros_like(x)

    drawn = sampler(still, nfe=1, dim=2, source=far)(torch.zeros(500, 1), seeded())
    assert torch.equal(drawn, far(500, seeded()))
    with pytest.raises(ValueError, match=r"source\(n\) must have shape \(500, 3\)"):
        sampler(still, nfe=1, dim=3, source=far)(torch.zeros(500, 1))
    with pytest.raises(TypeError, match="source must be a function"):
        sampler(still, nfe=1, dim=2, source="normal")


def test_sampler_without_a_dimension():
    with pytest.raises(ValueError, match="dim is missing"):
        sampler(known, nfe=1)
    with pytest.raises(ValueError, match="dim must be at least 1"):
        sampler(known, nfe=1, dim=0)


@pytest.mark.parametrize("method", METHODS)
def test_a_velocity_that_writes_into_x_spoils_nothing(method):
    def writes(t, x, c):
        return x.mul_(-1.0)

    x0 = torch.randn(4, 2, generator=seeded())
    before, nfe = x0.clone(), None if method == "dopri5" else 8
    made = integrate(writes, x0, nfe=nfe, method=method).x1
    assert torch.equal(x0, before)
    assert torch.allclose(made, integrate(lambda t, x, c: -x, x0, nfe=nfe, method=method).x1)


def test_a_stiff_field_ends(monkeypatch):
    monkeypatch.setattr(solvers, "MOST_EVALUATIONS", 300)
    with pytest.raises(RuntimeError, match=r"dopri5 stopped at t = 0.0.* 300 evaluations.*stiff"):
        integrate(lambda t, x, c: -1e6 * x, torch.ones(2, 2), method="dopri5")


def one_column(t, x, c=None, *length):
    return x[:, :1]


Z = torch.randn(8, 2, generator=seeded())
test_a_network_that_forgets_a_column_is_refused = refused(
    (lambda: straightness(one_column, Z), r"velocity must return shape \(8, 2\), got \(8, 1\)"),
    (lambda: Diffusion().ddim(one_column, Z, nfe=2), "network must return shape"),
    (lambda: Diffusion(3).ddpm(one_column, Z, noise=torch.zeros(2, 8, 2)), "network must return"),
    (lambda: TwoPasses().sample(one_column, Z), "network must return shape"),
    (lambda: jump(Forgetful(), Z, nfe=1), "network must return shape"),
    error=ValueError,
)


class Forgetful(MeanVelocity):
    """A network of mean velocities that forgets a column."""

    def __init__(self):
        super().__init__(VelocityMLP(2, 1, width=4, depth=1))

    def forward(self, t, x, c=None, length=0.0):
        return x[:, :1]


@pytest.mark.parametrize("around", [lambda net: Guided(net, 2.0), lambda net: net.forward])
def test_noise_has_the_type_of_the_network_inside(around):
    network = VelocityMLP(2, 1).double()
    drawn = sampler(around(network), nfe=2, dim=2)(torch.zeros(3, 1, dtype=torch.float64))
    assert drawn.dtype == torch.float64


@pytest.mark.parametrize("method", METHODS)
def test_a_velocity_may_return_the_same_buffer_each_time(method):
    """As static outputs of a compiled graph are: Heun's and Runge-Kutta's steps mixed them up."""
    x0, out = torch.randn(16, 2, generator=seeded()), torch.empty(16, 2)
    nfe = None if method == "dopri5" else 40
    found = [
        integrate(velocity, x0, nfe=nfe, method=method).x1
        for velocity in (lambda t, x, c: out.copy_(-x * (1 + t)), lambda t, x, c: -x * (1 + t))
    ]
    assert torch.equal(*found)


class Dropping(torch.nn.Module):
    """A network that draws while it trains."""

    dim = condition_dim = 2

    def __init__(self):
        super().__init__()
        self.drop = torch.nn.Dropout(0.5)

    def forward(self, t, x, c=None):
        return self.drop(x)


X0, C = torch.randn(4, 2, generator=seeded()), torch.ones(4, 2)


@pytest.mark.parametrize(
    "sample",
    [
        lambda net: sampler(net, nfe=2)(C, seeded()),
        lambda net: sampler(velocity_of(net, "data"), nfe=2, dim=2)(C, seeded()),
        lambda net: sampler(Guided(net, 1.0), nfe=2)(C, seeded()),
        lambda net: sampler(net.forward, nfe=2, dim=2)(C, seeded()),
        lambda net: sampler(partial(net), nfe=2, dim=2)(C, seeded()),
        lambda net: integrate(net, X0, C, nfe=2).x1,
        lambda net: jump(MeanVelocity(net).train(net.training), X0, C[:, :1], nfe=2),
        lambda net: TwoPasses().sample(net, X0, C),
        lambda net: Drifting().sample(net, X0, C),
        lambda net: Diffusion().ddim(net, X0, C, nfe=2),
        lambda net: straightness(net, X0, C),
        lambda net: Reflow(partial(net, 0.0))(X0, X0, C).x1,
    ],
)
def test_a_network_that_trains_is_not_sampled(sample):
    sample(Dropping().eval())
    with pytest.raises(ValueError, match="must be in eval mode"):
        sample(Dropping().train())


def test_a_network_without_anything_to_drop_is_sampled():
    net = Dropping().train()
    net.drop.p = 0.0
    assert torch.equal(integrate(net, X0, C, nfe=2).x1, integrate(net.eval(), X0, C, nfe=2).x1)


def test_a_class_in_the_place_of_a_network():
    with pytest.raises(TypeError, match="VelocityMLP"):  # it was searched without end
        integrate(VelocityMLP, X0, C, nfe=2)
