"""Another coupling pairs transformed data; the data stay, and the prior stays blind.

Each problem has data that do not depend on the condition once they are transformed.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from support import joined, refused, same, seeded, take

from cotlearn import couplings
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT, StratifiedOT
from cotlearn.couplings.base import Match
from cotlearn.couplings.transformed import Transformed, centred
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier, linear_skew, prior_skew
from cotlearn.mixtures import rotating_pair

INNER = [MinibatchOT(), ConditionalOT(3.0), StratifiedOT(8)]


def turn(x, angle):
    cos, sin = angle[:, 0].cos(), angle[:, 0].sin()
    return torch.stack([cos * x[:, 0] - sin * x[:, 1], sin * x[:, 0] + cos * x[:, 1]], 1)


def forward(x, c):
    return turn(x, -math.pi / 2 * c)


def inverse(x, c):
    return turn(x, math.pi / 2 * c)


def mean(c):
    return torch.cat([3 * (2 * c).sin(), 2 * c], dim=1)


def spread(c):
    return 0.3 + c.abs()


class Turned:
    """Both modes lie in the direction of the angle pi/2 c."""

    endless = rotating_pair()

    def wrap(self, coupling):
        return Transformed(coupling, forward, inverse)


class Shifted:
    """A location-scale family: two modes about a mean, at a distance, that follow c."""

    @property
    def endless(self):
        return self

    def sample(self, n, generator=None, scaled=True):
        c = 2 * torch.rand(n, 1, generator=generator) - 1
        modes = 2.0 * torch.randint(0, 2, (n, 1), generator=generator) - 1
        left = 0.3 * torch.randn(n, 2, generator=generator) + modes * torch.tensor([0.0, 1.0])
        return mean(c) + (spread(c) if scaled else 1.0) * left, c

    def wrap(self, coupling):
        return centred(coupling, mean, spread)


@pytest.fixture(params=[Turned(), Shifted()], ids=["framed", "centred"])
def problem(request):
    return request.param


def pairs_of(data, coupling, n=500, seed=0):
    x1, c = data.sample(n, generator=seeded(seed))
    x0 = torch.randn(n, 2, generator=seeded(seed + 1))
    return x1, c, coupling(x0, x1, c, seeded(seed + 2))


def test_the_rows_are_those_of_the_data_and_the_noise_turns_back(problem):
    x1, c, pairs = pairs_of(problem.endless, problem.wrap(MinibatchOT()))
    assert torch.equal(pairs.c, c[pairs.target_index])
    assert torch.equal(pairs.x1, x1[pairs.target_index])  # the very rows
    assert sorted(pairs.target_index.tolist()) == list(range(500))
    noise = torch.randn(500, 2, generator=seeded(1))[pairs.source_index]
    back = forward(pairs.x0, pairs.c) if isinstance(problem, Turned) else pairs.x0
    assert torch.allclose(back, noise, atol=1e-6)


def test_it_pairs_as_the_coupling_inside_pairs_transformed_data(problem):
    x1, c, pairs = pairs_of(problem.endless, problem.wrap(ConditionalOT(3.0)))
    seen = forward(x1, c) if isinstance(problem, Turned) else (x1 - mean(c)) / spread(c)
    x0 = torch.randn(500, 2, generator=seeded(1))
    inside = ConditionalOT(3.0)(x0, seen, c, seeded(2))
    assert torch.equal(pairs.target_index, inside.target_index)
    assert torch.equal(pairs.source_index, inside.source_index)


def test_naive_ot_inside_does_not_skew_and_straightens_the_most(problem):
    """Transformed, the data are the same for every c: there is nothing to know."""
    x1, c = problem.endless.sample(1600, generator=seeded())
    naive = MinibatchOT()
    tried = {"independent": Independent(), "naive": naive, "wrapped": problem.wrap(naive)}
    found = frontier(x1, c, tried, rows=1024, repetitions=2, progress=False)
    assert found["naive"].flagged
    assert not found["wrapped"].flagged
    assert found["wrapped"].candidates == 256
    variance = {point.name: point.one_step_variance for point in found}
    assert variance["wrapped"] < 0.4 * variance["independent"]


@pytest.mark.parametrize("seed", range(2))
def test_the_noise_stays_standard_normal_and_blind(problem, seed):
    *_, pairs = pairs_of(problem.endless, problem.wrap(MinibatchOT()), n=1024, seed=10 * seed)
    assert pairs.x0.mean(dim=0).abs().max() < 0.13
    assert (pairs.x0.T.cov() - torch.eye(2)).abs().max() < 0.24
    assert prior_skew(pairs.x0, pairs.c).p_value > 1e-4
    assert linear_skew(pairs.x0, pairs.c, degree=2).p_value > 1e-4


@pytest.mark.parametrize("inner", INNER, ids=repr)
def test_it_passes_for_the_coupling_inside(problem, inner):
    coupling = problem.wrap(inner)
    data = Dataset(*problem.endless.sample(100, generator=seeded()))
    assert coupling.epoch_rows(data) == inner.epoch_rows(data)
    assert coupling.name == inner.name
    assert coupling.traits == replace(inner.traits, needs_condition=True)
    assert repr(coupling).startswith(f"Transformed(coupling={inner!r}, forward=")
    assert " at 0x" not in repr(coupling)
    next(coupling.stream(data, batch_size=50))
    again = problem.wrap(StratifiedOT(8))
    again.load_state_dict(coupling.state_dict())
    assert again.state_dict().keys() == coupling.state_dict().keys()


def test_epochs_drawn_from_endless_data(problem):
    coupling = problem.wrap(StratifiedOT(4, n_samples=64))
    assert len(joined(take(coupling, problem.endless, 2, 64), "x1").unique(dim=0)) == 128


def test_a_transform_of_nothing_changes_nothing():
    plain = pairs_of(Shifted(), ConditionalOT(2.0))[2]
    for still in (
        Transformed(ConditionalOT(2.0), lambda x, c: x, lambda x, c: x),
        centred(ConditionalOT(2.0), lambda c: torch.zeros(len(c), 2)),
    ):
        assert same(pairs_of(Shifted(), still)[2], plain)


def test_the_mean_alone_leaves_the_length_of_noise_to_the_condition():
    """Without its spread the family is centred only by half; squares of x0 tell so."""

    def told(coupling):
        *_, pairs = pairs_of(Shifted(), coupling, n=2048)
        return linear_skew(pairs.x0.square(), pairs.c, degree=2).explained

    assert told(centred(MinibatchOT(), mean)) > 0.05
    assert abs(told(centred(MinibatchOT(), mean, spread))) < 0.015


def test_within_one_condition_centring_changes_no_pairing():
    """Neither a shift nor one number for the spread changes which pairing is the cheapest."""
    x1, _ = Shifted().sample(200, generator=seeded())
    c = torch.full((200, 1), 0.4)
    x0 = torch.randn(200, 2, generator=seeded(5))
    plain = MinibatchOT()(x0, x1, c, seeded())
    about = centred(MinibatchOT(), mean, spread)(x0, x1, c, seeded())
    cost = [float((p.x0 - p.x1).square().sum()) for p in (plain, about)]
    assert cost[1] == pytest.approx(cost[0], rel=1e-5)


def test_a_linear_mean_in_one_stratum_is_that_of_stratified_ot():
    """`StratifiedOT(residual=True)` regresses inside strata; with one, that is a global line."""
    x1, c = Shifted().sample(400, generator=seeded(), scaled=False)
    x0 = torch.randn(400, 2, generator=seeded(1))
    features = torch.cat([torch.ones_like(c), c], dim=1)
    weights = torch.linalg.lstsq(features.double(), x1.double()).solution.float()

    def line(some):
        return torch.cat([torch.ones_like(some), some], dim=1) @ weights

    one = centred(StratifiedOT(1), line)(x0, x1, c, seeded())
    two = StratifiedOT(1, residual=True)(x0, x1, c, seeded())
    costs = [float((p.x0 - (p.x1 - line(p.c))).square().sum()) for p in (one, two)]
    assert costs[0] == pytest.approx(costs[1], rel=1e-3)
    assert (one.target_index == two.target_index).float().mean() > 0.9  # but for ties by rounding


def test_its_words_name_what_is_inside():
    text = repr(Transformed(Independent(), forward, inverse))
    assert text == "Transformed(coupling=Independent(), forward=forward, inverse=inverse)"
    text = repr(centred(Independent(), mean, spread))
    assert "forward=Residual(mean=mean, spread=spread)" in text
    assert centred(Independent(), mean) == centred(Independent(), mean)


X, C = torch.randn(20, 2), torch.randn(20, 1)
OT = MinibatchOT()


def framed(forward, inverse):
    return Transformed(OT, forward, inverse)(X, X, C)


def about(mean, spread=None):
    return centred(OT, mean, spread)(X, X, C)


test_bad_input = refused(
    (lambda: Transformed("exact", forward), TypeError, "coupling must be a Coupling"),
    (lambda: Transformed(couplings.ModelAligned(), forward), ValueError, "network's or teacher's"),
    (lambda: Transformed(couplings.Reflow(forward), forward), ValueError, "network's or teacher's"),
    (lambda: Transformed(couplings.SemidiscreteOT(), forward), ValueError, "nor SemidiscreteOT"),
    (lambda: centred(ConditionalOT(1.0, label="source"), mean), ValueError, "label them by"),
    (lambda: Transformed(OT, forward)(X, X), TypeError, "needs the conditions c"),
    (lambda: take(centred(StratifiedOT(2), mean), Shifted(), 1), TypeError, "endless"),
    (lambda: Transformed(OT, None, inverse), TypeError, "forward must be a function"),
    (lambda: Transformed(OT, forward, 3), TypeError, "inverse must be a function"),
    (lambda: framed(lambda x, c: 2 * x, inverse), ValueError, "forward must keep the length"),
    (lambda: framed(forward, lambda x, c: x + 1), ValueError, "inverse must keep the length"),
    (
        lambda: framed(lambda x, c: x[:, :1], inverse),
        ValueError,
        r"forward\(x, c\) must have shape \(20, 2\), got \(20, 1\)",
    ),
    (lambda: framed(lambda x, c: x / 0, inverse), ValueError, "forward.* has NaN or infinite"),
    (lambda: centred(OT, None), TypeError, "mean must be a function of c"),
    (lambda: centred(OT, mean, 3), TypeError, "spread must be a function of c"),
    (lambda: about(lambda c: c), ValueError, r"mean.* must .* \(20, 2\), got \(20, 1\)"),
    (lambda: about(lambda c: 0.0), TypeError, "mean.* must .* got float"),
    (lambda: about(lambda c: mean(c) / 0), ValueError, "mean.* has NaN or infinite"),
    (
        lambda: about(mean, lambda c: c[0]),
        ValueError,
        r"spread.* must have shape \(20, 2\), got \(1,\)",
    ),
    (lambda: about(mean, lambda c: -c.abs()), ValueError, "spread must be positive, got -"),
    (lambda: about(mean, lambda c: c * math.nan), ValueError, "spread.* has NaN or infinite"),
)


def test_refilled_buffers_and_a_mean_that_learns_are_seen_anew():
    """The cache knew tensors by identity: .8 % of the pairs were right."""
    x0, x1, c = (torch.randn(64, 2, generator=seeded(k)) for k in range(3))
    pair = centred(MinibatchOT(), lambda c: 10 * c)
    pair(x0, x1, c)
    x1.normal_(generator=seeded(8))
    c.numpy()[:] = torch.randn(64, 2, generator=seeded(9)).numpy()
    fresh = centred(MinibatchOT(), lambda c: 10 * c)(x0, x1, c)
    assert torch.equal(pair(x0, x1, c).target_index, fresh.target_index)


@pytest.mark.parametrize("rows", [100, 3000])
def test_a_mean_network_that_is_trained_on_counts_at_once(rows):
    net = torch.nn.Linear(2, 2)
    x0, x1, c = (torch.randn(rows, 2, generator=seeded(k)) for k in range(3))
    pair, seen = centred(Independent(), net), []
    pair.coupling.match = lambda x0, seen_x1, c, rng: (
        seen.append(seen_x1) or Match(np.arange(rows), np.arange(rows))
    )
    pair(x0, x1, c)
    with torch.no_grad():
        net.weight.add_(0.1)
    pair(x0, x1, c)
    assert torch.allclose(seen[1], x1 - net(c).detach(), atol=1e-4)


@pytest.mark.parametrize("kind", [torch.float32, torch.bfloat16])
def test_noise_keeps_its_type(kind):
    """A condition in double precision made the noise double."""
    x = torch.randn(64, 2, generator=seeded()).to(kind)
    c = torch.randn(64, 1, generator=seeded(1)).sign().double()
    mirror = Transformed(MinibatchOT(), lambda x, c: x * c, lambda x, c: x * c)
    assert mirror(x, x, c).x0.dtype == kind


def turned(x, c):
    return torch.view_as_real(torch.view_as_complex(x) * torch.view_as_complex(c))


def turned_back(x, c):
    return torch.view_as_real(torch.view_as_complex(x) * torch.view_as_complex(c).conj())


def test_an_inverse_that_does_not_undo_is_refused():
    """A rotation with the wrong sign keeps all lengths, and pairs were nearly those of chance."""
    angle = 6.28 * torch.rand(64, generator=seeded())
    c = torch.stack([angle.cos(), angle.sin()], dim=1)
    x0, x1 = torch.randn(2, 64, 2, generator=seeded())
    Transformed(MinibatchOT(), turned_back, turned)(x0, x1, c, seeded())
    with pytest.raises(ValueError, match="inverse must undo forward"):
        Transformed(MinibatchOT(), turned, turned)(x0, x1, c, seeded())


def test_an_inverse_inside_another_transform_is_refused():
    with pytest.raises(ValueError, match="must not have an inverse of its own"):
        centred(Transformed(MinibatchOT(), turned_back, turned), lambda c: 5 * c)


def test_noise_for_a_frame_that_mixes_a_constant_column():
    from cotlearn.bridge import paired_noise

    angle = 6.28 * torch.rand(20_000, generator=seeded())
    c = torch.stack([angle.cos(), angle.sin()], dim=1)
    actions = torch.randn(20_000, 2, generator=seeded()) * torch.eye(2)[0]
    noise = paired_noise(Transformed(Independent(), turned_back, turned), actions, c)
    for some in (c[:, 0].abs() < 0.3, c[:, 0].abs() > 0.9):
        assert float(noise[some, 0].var()) == pytest.approx(1, abs=0.06)


def test_a_mean_that_trains_is_refused():
    """Equal calls gave other pairs, and moved the statistics of the caller's network."""
    mean = torch.nn.Sequential(torch.nn.Linear(2, 2), torch.nn.BatchNorm1d(2))
    x0, x1, c = torch.randn(3, 8, 2, generator=seeded())
    centred(MinibatchOT(), mean.eval())(x0, x1, c)
    with pytest.raises(ValueError, match="mean must be in eval mode"):
        centred(MinibatchOT(), mean.train())(x0, x1, c)


def test_a_padded_step_counts_for_nothing_around_a_mean():
    """It counted as minus the mean, and its noise followed the condition (corr^2 .7)."""
    from cotlearn.bridge import paired_noise

    coupling, c = centred(MinibatchOT(), lambda c: 2 * c.repeat(1, 4)), torch.randn(4096, 1)
    pad = (torch.arange(4) >= torch.randint(1, 5, (4096, 1))).expand(4096, 4)
    x1 = (2 * c + 0.3 * torch.randn(4096, 4))[:, :, None]
    noise = torch.cat([
        paired_noise(coupling, *some, is_pad=out)
        for *some, out in zip(x1.split(256), c.split(256), pad.split(256), strict=True)
    ])  # fmt: skip
    for step in range(1, 4):
        for some in (pad[:, step], ~pad[:, step]):
            both = torch.stack([noise[some, step, 0], c[some, 0]])
            assert both.corrcoef()[0, 1].square() < 0.02


def test_padding_in_a_frame_is_refused():
    from cotlearn.bridge import paired_noise

    coupling, c = Transformed(MinibatchOT(), lambda x, c: -x), torch.randn(8, 1)
    actions, pad = torch.randn(8, 4, 1), torch.arange(4).expand(8, 4)
    paired_noise(coupling, actions, c, is_pad=pad > 9)
    with pytest.raises(ValueError, match="is_pad must mark no step"):
        paired_noise(coupling, actions, c, is_pad=pad > 2)


MODES = torch.tensor([[0.3, 0.1], [-0.7, 1.1], [-0.4, -1.9], [1.3, 0.77]])
MEANS = torch.tensor([[0.1, 12.3], [0.7, -3.3], [12.3, 0.017], [-101.7, 5.1]])


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("kind", ["mean", "single mean", "mean and spread", "frame"])
def test_values_that_differ_by_rounding_are_equal(kind, dtype):
    """Four values about the mean: rounding, which the condition tells, must not choose pairs."""
    modes, means = MODES.to(dtype), MEANS.to(dtype) / 3
    coupling = {
        "mean": centred(MinibatchOT(), lambda c: c @ means),
        "single mean": centred(MinibatchOT(), lambda c: (c @ means).float()),
        "mean and spread": centred(MinibatchOT(), lambda c: c @ means, lambda c: 0.3 + c[:, :1]),
        "frame": Transformed(
            MinibatchOT(), lambda x, c: turn(x, -1 - c), lambda x, c: turn(x, 1 + c)
        ),
    }[kind]
    noise, label = [], []
    for seed in range(60):
        g = seeded(seed)
        given = torch.randint(4, (256,), generator=g)
        some = modes[torch.randint(4, (256,), generator=g)]
        c = torch.eye(4, dtype=dtype)[given]
        if "spread" not in kind and kind != "frame":
            x1 = c @ means + some
        elif kind == "frame":
            c = given[:, None].to(dtype)
            x1 = turn(some, 1 + c)
        else:
            x1 = c @ means + (0.3 + c[:, :1]) * some
        pairs = coupling(torch.randn(256, 2, generator=g, dtype=dtype), x1, c, g)
        noise.append(coupling.forward(pairs.x0, pairs.c) if kind == "frame" else pairs.x0)
        label.append(given[pairs.target_index])
    x0, given = torch.cat(noise).double(), torch.cat(label)
    within = torch.stack([x0[given == k].mean(dim=0) for k in range(4)])[given]
    assert (within - x0.mean(dim=0)).square().sum() < 1e-3 * (x0 - x0.mean(dim=0)).square().sum()


def regret(pairs, rows=slice(None)):
    """What these pairs cost above the optimum, as a share of what random pairs do."""
    x0, x1 = pairs.x0[rows].double().numpy(), pairs.x1[rows].double().numpy()
    cost = cdist(x0, x1, "sqeuclidean")
    best = cost[linear_sum_assignment(cost)].mean()
    return (np.trace(cost) / len(cost) - best) / (cost.mean() - best)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float32], ids=str)
def test_dense_values_are_paired_as_they_are_in_any_type(dtype):
    x0, x1, c = (torch.randn(512, 2, generator=seeded(k)).to(dtype) for k in range(3))
    assert regret(centred(MinibatchOT(), torch.zeros_like)(x0, x1, c, seeded())) < 1e-3


@pytest.mark.parametrize("far", [1e4, 1e6])
def test_one_row_far_off_merges_no_others(far):
    x0, x1, c = (torch.randn(512, 2, generator=seeded(k)) for k in range(3))
    x1[7] = far
    pairs = centred(MinibatchOT(), torch.zeros_like)(x0, x1, c, seeded())
    assert regret(pairs, pairs.target_index != 7) < 1e-3


def test_residuals_of_narrow_conditions_are_told_apart():
    x0, z, c = (torch.randn(512, 1, generator=seeded(k)) for k in range(3))
    coupling = centred(MinibatchOT(), lambda c: 50 * c, lambda c: (-3 * c.abs()).exp())
    pairs = coupling(x0, 50 * c + (-3 * c.abs()).exp() * z, c, seeded())
    residuals = z[pairs.target_index]
    assert regret(replace(pairs, x1=residuals)) < 1e-2
