"""Arguments that passed, or met an error of another library: each is named."""

import math

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import (
    ConditionalOT,
    EmbeddedClusters,
    Independent,
    KMeansCondition,
    combine,
)
from cotlearn.couplings.assignment import exact_permutation
from cotlearn.datasets import Dataset, Standardiser
from cotlearn.diagnostics import between_within, deployment_gap, frontier, linear_skew
from cotlearn.diagnostics.regression import regression
from cotlearn.flows import VelocityMLP, fit, integrate, sampler
from cotlearn.flows.matching import flow_matching_step
from cotlearn.metrics import straightness
from cotlearn.potentials import ICNN, invert
from cotlearn.report import from_arrays
from cotlearn.robots.episodes import read

X = torch.randn(6, 2, generator=seeded())
NET, BARE = VelocityMLP(2, 3, width=8, depth=1, seed=0), VelocityMLP(2, width=8, depth=1, seed=0)
C = torch.zeros(6, 3)
MANY = torch.randn(40, 2, generator=seeded())


def train(**options):
    fit(BARE, Dataset(X), Independent(), steps=1, batch_size=2, **options)


test_networks = refused(
    (lambda: NET(math.nan, X, C), r"t must lie in \[0, 1\], got values from nan to nan"),
    (lambda: NET(2, X, C), r"t must lie in \[0, 1\], got values from 2 to 2"),
    (lambda: NET(torch.linspace(0, 2, 6), X, C), r"t must lie in \[0, 1\], got values from 0 to 2"),
    (lambda: NET(torch.zeros(5), X, C), r"t must be a number or have shape \(6,\), got \(5,\)"),
    (lambda: NET(torch.zeros(6, 1), X, C), r"t must be .* got \(6, 1\)"),
    (lambda: NET(0.5, X, C[:5]), r"c must have shape \(6, 3\), got \(5, 3\)"),
    (lambda: NET(0.5, X), r"c must have shape \(6, 3\), got None"),
    (lambda: BARE(0.5, X, C), "c must be None: condition_dim is 0"),
    error=ValueError,
)
test_solvers = refused(
    (lambda: integrate(lambda t, x, c: x * math.nan, X, nfe=2), RuntimeError, "6 of 6 rows"),
    (lambda: integrate(lambda t, x, c: x**9 * 1e30, X, nfe=4), RuntimeError, "ended with NaN or"),
    (lambda: integrate(NET, X.to("meta"), C, nfe=2), TypeError, "x0 must hold numbers"),
    (lambda: integrate(NET, X.to_sparse(), C, nfe=2), TypeError, "x0 must be a dense tensor"),
    (lambda: integrate(NET, X.to(torch.float8_e5m2), C, nfe=2), TypeError, "x0 must have 16, 32"),
)
test_seeds_and_paths = refused(
    (lambda: train(seed=2**70), "seed must be at most 9223372036854775807, got 11805"),
    (lambda: VelocityMLP(2, seed=2**70), "seed must be at most"),
    (lambda: KMeansCondition(2, seed=2**32), "seed must be at most 4294967295"),
    (lambda: train(checkpoint="a\0b"), "checkpoint must be a path without a NUL character"),
    error=ValueError,
)
test_names_of_conditions = refused(
    (lambda: combine([C]), TypeError, "conditions must be a dictionary of names, .* got list"),
    (lambda: combine({"a": X}, [1.0]), TypeError, "weights must be a dictionary .* got list"),
)


@pytest.mark.parametrize("seed", [2**63 - 1, 2**32])
def test_the_largest_seeds_are_taken(seed):
    train(seed=seed)
    VelocityMLP(2, seed=seed)
    rng = np.random.default_rng(0)
    regression(rng.normal(size=(60, 2)), rng.normal(size=(60, 2)), seed=seed)


@pytest.mark.parametrize("names", [("x1", "c"), ("about",)])
def test_a_file_that_is_no_recording_says_which_are_wanted(tmp_path, names):
    """'about is not a file in the archive'."""
    np.savez(tmp_path / "ok.npz", **dict.fromkeys(names, np.zeros(3)))
    if names == ("about",):
        with pytest.raises(ValueError, match="damaged or no file of demonstrations"):
            read(tmp_path / "ok.npz")
        return
    with pytest.raises(ValueError, match=r"it holds c, x1. Wanted is an .npz that"):
        read(tmp_path / "ok.npz")


def split(groups):
    between_within(MANY, MANY, groups=groups)


MASKED = np.ma.array(range(40), mask=[1, *39 * [0]])
test_groups = refused(
    (lambda: split(["a", None] * 20), TypeError, "groups must hold .*strings"),
    (lambda: split([math.nan] * 40), ValueError, "groups must be finite"),
    (lambda: split(MASKED), ValueError, "groups has masked values"),
    (lambda: from_arrays(X, C, group=[math.nan] * 6), ValueError, "group must be finite"),
)
test_numbers = refused(
    (lambda: ConditionalOT(10**400), "condition_weight must be a number that float64 holds"),
    (
        lambda: Standardiser.fit(X).inverse(X[:, :1]),
        r"rows must have shape \(rows, 2\), got \(6, 1\)",
    ),
    (lambda: combine({"a": X}, {1: 2.0, "z": 3.0}), r"weights has unknown names \[1, 'z'\]"),
    (lambda: Standardiser.fit(1e200 * X.double()), "whose squares float64 holds"),
    error=ValueError,
)
test_kinds = refused(
    (lambda: invert(ICNN(2).half(), X.half()), "y must have 32 or 64 bits, got torch.float16"),
    (lambda: flow_matching_step(BARE, Independent()(X, X), np.random.default_rng()), "generator"),
    (lambda: linear_skew(MANY, MANY, degree=np.array([1, 2])), "degree must be an integer"),
    (lambda: exact_permutation(np.eye(3) + 1j), "cost must hold real numbers"),
    (lambda: Standardiser.fit(X)(X.numpy()), "rows must be a Tensor, as those of the fit"),
    error=TypeError,
)


def test_a_squared_weight_may_be_infinite():
    assert ConditionalOT.from_gamma(1e200) == ConditionalOT(math.inf)


def test_an_array_that_runs_backwards():
    x = np.arange(8.0).reshape(4, 2)
    assert np.array_equal(Standardiser.fit(x[::-1]).mean, x.mean(axis=0))


@pytest.mark.parametrize("kind", [torch.float64, torch.bfloat16])
def test_noise_has_the_type_of_the_weights(kind):
    net = VelocityMLP(2, 3, width=8, depth=1, seed=0).to(kind)
    assert sampler(net, nfe=1)(C.to(kind)).dtype == kind


@pytest.mark.parametrize("layer", [torch.nn.Dropout(0.5), torch.nn.BatchNorm1d(3)], ids=str)
def test_an_encoder_that_trains_is_refused(layer):
    """61 % of the labels changed between two calls, or they depended on the batch."""
    embed = torch.nn.Sequential(torch.nn.Linear(3, 3), layer)
    with pytest.raises(ValueError, match="embed must be in eval mode"):
        EmbeddedClusters(embed, KMeansCondition(2))
    EmbeddedClusters(embed.eval(), KMeansCondition(2))


def test_lengths_of_large_numbers_are_finite():
    """In single precision their squares are infinite."""
    x = 1e20 * torch.randn(400, 2, generator=seeded())
    found = frontier(x, torch.eye(2)[torch.arange(400) % 2], {"i": Independent()}, progress=False)
    assert math.isfinite(found["i"].transport_cost)
    assert math.isfinite(straightness(lambda t, x, c: torch.zeros_like(x), x))


def test_held_out_data_need_a_condition():
    net, data = VelocityMLP(2, 2, width=8, depth=1, seed=0), Dataset(MANY, MANY)
    with pytest.raises(TypeError, match="held_out must be data with a condition"):
        deployment_gap(net, data, Independent(), n=100, held_out=Dataset(MANY))
