"""The mixtures against their own definition: grids, Monte Carlo, the continuity equation."""

import copy
import math
import pickle
from functools import cache, partial

import numpy as np
import pytest
import torch
from scipy.stats import ks_2samp
from support import refused, seeded, toys
from torch.distributions import Categorical, Independent, MixtureSameFamily, Normal

from cotlearn import mixtures
from cotlearn.flows import integrate
from cotlearn.metrics import squared_w2

WITH_DENSITY = [*toys().values(), mixtures.petals(n_conditions=3)]
ALL = [*WITH_DENSITY, mixtures.moons(condition="x")]
every = pytest.mark.parametrize("data", ALL, ids=lambda d: f"{d.name}{d.condition_dim}")
with_density = pytest.mark.parametrize(
    "data", WITH_DENSITY, ids=lambda d: f"{d.name}{d.condition_dim}"
)


def law_at(data, t, c):
    """p_t(x | c) of x_t = (1 - t) x0 + t x1, by torch's own mixtures."""
    log_weights, means, stds = (part.double() for part in data.components(c))
    stds_t = ((1 - t) ** 2 + t**2 * stds**2).sqrt().clamp_min(1e-9)  # torch refuses 0
    parts = Independent(Normal(t * means, stds_t), 1)
    return MixtureSameFamily(Categorical(logits=log_weights), parts)


@every
def test_shapes_dtypes_and_seeds(data):
    x1, c = data.sample(7, generator=seeded(1))
    assert x1.shape == (7, data.dim) == (7, 2)
    assert c.shape == (7, data.condition_dim)
    assert x1.dtype == c.dtype == torch.float32
    again, c_again = data.sample(7, generator=seeded(1))
    assert torch.equal(x1, again)
    assert torch.equal(c, c_again)
    other, _ = data.sample(7, generator=seeded(2))
    assert not torch.equal(x1, other)
    assert data.sample_conditions(3, generator=seeded()).shape == (3, data.condition_dim)
    assert data.velocity(0.5, x1, c).shape == (7, 2)


@every
def test_weights_sum_to_one(data):
    log_weights, _, _ = data.components(data.conditions(n=5))
    assert torch.allclose(log_weights.exp().sum(dim=1), torch.ones(len(log_weights)), atol=1e-5)


@every
def test_representative_conditions(data):
    c = data.conditions(n=5)
    if data.condition_dim > 1:  # labels: all of them, whatever n
        assert torch.equal(c, torch.eye(data.condition_dim))
    else:
        assert c.shape == (5, 1)
        assert (c.diff(dim=0) > 0).all()


@with_density
def test_density_integrates_to_one(data):
    axis = torch.linspace(-9, 9, 121, dtype=torch.float64)
    grid = torch.cartesian_prod(axis, axis)
    cell = float(axis[1] - axis[0]) ** 2
    for c in data.conditions(n=3)[:3]:
        mass = data.log_density(grid, c.double().expand(len(grid), -1)).exp().sum() * cell
        assert mass == pytest.approx(1, abs=1e-4)


@with_density
def test_density_is_that_of_torch(data):
    x, c = data.sample(50, generator=seeded())
    expected = law_at(data, 1.0, c).log_prob(x.double())
    assert torch.allclose(data.log_density(x, c).double(), expected, atol=1e-3)


def test_no_density_where_the_condition_fixes_a_coordinate():
    data = mixtures.moons(condition="x")
    x, c = data.sample(50, generator=seeded())
    assert torch.equal(x[:, :1], c)
    with pytest.raises(ValueError, match="no density"):
        data.log_density(x, c)


@every
def test_samples_given_c_have_the_moments_of_the_mixture(data):
    n = 20_000
    for c in data.conditions(n=3)[:3]:
        law = law_at(data, 1.0, c[None])
        x = data.sample_given(c.expand(n, -1), generator=seeded()).double()
        error = (law.variance[0] / n).sqrt()
        assert ((x.mean(dim=0) - law.mean[0]).abs() <= 5 * error + 1e-6).all()
        assert torch.allclose(x.var(dim=0), law.variance[0], rtol=0.06, atol=1e-6)


def test_petals_sit_where_they_should():
    data = mixtures.petals(n_conditions=4)
    _, means, stds = data.components(data.conditions())
    assert torch.allclose(means[0], torch.tensor([[4.0, -1.2], [4.0, 1.2]]), atol=1e-5)
    assert torch.allclose(means[1], torch.tensor([[1.2, 4.0], [-1.2, 4.0]]), atol=1e-5)
    assert torch.allclose(stds, torch.full_like(stds, 0.25))


def test_moving_modes_keep_their_mean_and_rotating_pair_moves_it():
    def mean(data):
        log_weights, means, _ = data.components(data.conditions(n=9))
        return (log_weights.exp()[:, :, None] * means).sum(dim=1)

    assert mean(mixtures.moving_modes()).abs().max() < 1e-6
    assert torch.allclose(mean(mixtures.rotating_pair()).norm(dim=1), torch.tensor(3.0))


def test_the_marginal_of_both_moons_is_the_same():
    by_class, _ = mixtures.moons().sample(700, generator=seeded(0))
    by_x, _ = mixtures.moons(condition="x").sample(700, generator=seeded(1))
    other, _ = mixtures.moons().sample(700, generator=seeded(2))
    assert squared_w2(by_class, by_x) < 2 * squared_w2(by_class, other)


def torchdyn(n, rng):
    """`generate_moons(n, noise=0.2)` as torchdyn describes it, made 3 x as large; n even."""
    angle = np.linspace(0, np.pi, n // 2)
    upper = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    x = np.concatenate([upper, [1, 0.5] - upper]) + 0.2 * rng.random((n, 1))
    return torch.tensor(3 * x - 1, dtype=torch.float32)


@pytest.mark.parametrize("condition", ["class", "x"])
def test_moons_of_torchdyn(condition):
    data = mixtures.moons(condition, torchdyn=True)
    x, c = data.sample(1000, generator=seeded(0))
    theirs = [torchdyn(1000, np.random.default_rng(seed)) for seed in (0, 1)]
    assert squared_w2(x, theirs[0]) == pytest.approx(squared_w2(*theirs), rel=0.3)  # the floor
    if condition == "class":
        assert c.sum(dim=0).tolist() == [500, 500]
        assert x[c[:, 0] == 1, 1].min() >= -1 > x[c[:, 0] == 0, 1].min()
    else:
        assert torch.equal(c, x[:, :1])
    c_only = data.sample_conditions(5, generator=seeded(3))
    assert torch.equal(c_only, data.sample(5, generator=seeded(3))[1])
    again = data.sample_given(data.conditions(5), generator=seeded(3))
    assert torch.equal(again, data.sample_given(data.conditions(5), generator=seeded(3)))
    assert data.sample(1)[0].shape == (1, 2)


@pytest.mark.parametrize("condition", ["class", "x"])
def test_moons_of_torchdyn_given_c(condition):
    """The same c, the other coordinate drawn again: no two-sample test can tell."""
    data = mixtures.moons(condition, torchdyn=True)
    x, c = data.sample(40_000, generator=seeded(0))
    drawn_again = data.sample_given(c, generator=seeded(1))
    if condition == "x":
        assert torch.equal(drawn_again[:, :1], c)
    for low in range(-4, 5):  # strips of c, or of x where c is the moon
        strips = [v[(v[:, 0] > low) & (v[:, 0] < low + 0.5), 1] for v in (x, drawn_again)]
        assert ks_2samp(*strips).pvalue > 1e-4


BY_CLASS, BY_X = (mixtures.moons(condition, torchdyn=True) for condition in ("class", "x"))
test_moons_of_torchdyn_have_no_density_here = refused(
    (lambda: BY_CLASS.log_density(*BY_CLASS.sample(4)), "torchdyn's moons: only samples are known"),
    (lambda: BY_X.log_density(*BY_X.sample(4)), "torchdyn's moons: only samples are known"),
    (lambda: BY_CLASS.velocity(0.5, *BY_CLASS.sample(4)), "only samples are known"),
    (lambda: BY_X.velocity(0.5, *BY_X.sample(4)), "only samples are known"),
    (lambda: BY_X.sample_given(torch.tensor([[0.0], [-4.1]])), r"c must lie between -4 and 5\.6"),
    (lambda: BY_X.sample_given(torch.tensor([[0.0], [5.7]])), r"c must lie between -4 and 5\.6"),
    (lambda: BY_CLASS.sample_given(torch.full((2, 2), 0.5)), "one-hot"),
    error=ValueError,
)


@cache
def drawn(data, n=100_000):
    """Many x1 for one condition c."""
    c = data.conditions(n=3)[:1]
    return data.sample_given(c.expand(n, -1), generator=seeded(0)).double(), c


@pytest.mark.slow
@every
@pytest.mark.parametrize("t", [0.1, 0.5, 0.8])
def test_velocity_is_the_posterior_average(data, t):
    """Monte Carlo: x0 = (x - t x1) / (1 - t) with weight N(x0; 0, I) for x1 from p(x1 | c)."""
    x1, c = drawn(data)
    x = t * x1[:3] + (1 - t) * torch.randn(3, 2, generator=seeded(1)).double()
    for point in x:
        x0 = (point - t * x1) / (1 - t)
        weight = torch.softmax(-x0.square().sum(dim=1) / 2, dim=0)
        expected = weight @ (x1 - x0)
        effective = 1 / weight.square().sum()
        error = ((weight @ (x1 - x0 - expected).square()) / effective).sqrt()
        got = data.velocity(t, point[None], c.double())[0]
        assert ((got - expected).abs() < 5 * error + 1e-3).all()


@every
def test_velocity_at_both_ends(data):
    x, c = data.sample(20, generator=seeded())
    noise = torch.randn(20, 2, generator=seeded(3))
    mean = law_at(data, 1.0, c).mean.float()
    assert torch.allclose(data.velocity(0.0, noise, c), mean - noise, atol=1e-4)
    assert torch.allclose(data.velocity(1.0, x, c), x, atol=1e-4)  # E[x0 | x1] = 0


@with_density
@pytest.mark.parametrize("t", [0.25, 0.6, 0.9])
def test_continuity_equation(data, t):
    """d p_t/dt + div(p_t v) = 0, by central differences in float64."""
    c = data.conditions(n=3)[:3]
    c = c.repeat(10, 1).double()
    x = law_at(data, t, c).sample()
    h = 1e-4

    def density(time, points):
        return law_at(data, time, c).log_prob(points).exp()

    def flux(points):
        return density(t, points)[:, None] * data.velocity(t, points, c)

    change = (density(t + h, x) - density(t - h, x)) / (2 * h)
    step = h * torch.eye(2, dtype=torch.float64)
    divergence = sum(
        (flux(x + step[i])[:, i] - flux(x - step[i])[:, i]) / (2 * h) for i in range(2)
    )
    scale = change.abs().max() + density(t, x).max()
    assert ((change + divergence).abs() < 1e-4 * scale).all()


@every
def test_velocity_carries_noise_to_the_data(data):
    c = data.conditions(n=3)[1:2].expand(600, -1)
    noise = torch.randn(600, 2, generator=seeded(0))
    made = integrate(data.velocity, noise, c, nfe=160, method="rk4").x1
    fresh = data.sample_given(c, generator=seeded(1))
    floor = squared_w2(fresh, data.sample_given(c, generator=seeded(2)))
    assert squared_w2(made, fresh) < 3 * floor + 0.02


def test_velocity_takes_one_time_or_one_a_row():
    data = mixtures.petals()
    x, c = data.sample(4, generator=seeded())
    each = data.velocity(torch.full((4,), 0.3), x, c)
    assert torch.equal(data.velocity(0.3, x, c), each)
    assert torch.equal(data.velocity(torch.tensor(0.3), x, c), each)


def test_inputs_stay_as_they_are():
    data = mixtures.moons(condition="x")
    x, c = data.sample(5, generator=seeded())
    before = x.clone(), c.clone()
    data.velocity(0.4, x, c)
    data.sample_given(c)
    assert all(map(torch.equal, (x, c), before))


DATA = mixtures.petals()
X, C = DATA.sample(5, generator=seeded())
test_bad_input = refused(
    (lambda: DATA.sample(0), ValueError, "n must be at least 1"),
    (lambda: DATA.sample(2.5), TypeError, "n must be an integer"),
    (lambda: DATA.conditions(0), ValueError, "n must be at least 1"),
    (lambda: DATA.sample_given(C[:, :3]), ValueError, "c has 3 columns, expected 4"),
    (lambda: DATA.sample_given(None), TypeError, "c must be a torch tensor"),
    (lambda: DATA.sample_given(C * math.nan), ValueError, "c has NaN"),
    (lambda: DATA.sample_given(torch.full((2, 4), 0.25)), ValueError, "one-hot"),
    (lambda: DATA.log_density(X[:2], C), ValueError, "c has 5 rows, x has 2"),
    (lambda: DATA.log_density(X[:, :1], C), ValueError, "x has 1 columns, expected 2"),
    (lambda: DATA.velocity(1.5, X, C), ValueError, r"t must lie in \[0, 1\]"),
    (lambda: DATA.velocity(-0.1, X, C), ValueError, r"t must lie in \[0, 1\]"),
    (lambda: DATA.velocity(math.nan, X, C), ValueError, r"t must lie in \[0, 1\]"),
    (lambda: DATA.velocity(torch.zeros(3), X, C), ValueError, "t must .* shape"),
    (lambda: DATA.velocity(0.5, X * math.inf, C), ValueError, "x has NaN or infinite"),
    (lambda: mixtures.petals(n_conditions=0), ValueError, "n_conditions must be at least 1"),
    (lambda: mixtures.moons("y"), ValueError, "condition must be one of class, x; got 'y'"),
)


@pytest.mark.parametrize(
    "make",
    [
        *(mixtures.petals, mixtures.moving_modes, mixtures.rotating_pair, mixtures.fork),
        *(mixtures.eight_gaussians, partial(mixtures.petals, 3)),
        *(partial(mixtures.moons, "x"), partial(mixtures.moons, torchdyn=True)),
    ],
)
def test_a_mixture_can_be_sent_to_another_process(make):
    data = make()
    for again in (pickle.loads(pickle.dumps(data)), copy.deepcopy(data)):
        assert type(again) is type(data)
        for a, b in zip(*(one.sample(9, generator=seeded()) for one in (data, again)), strict=True):
            assert torch.equal(a, b)
