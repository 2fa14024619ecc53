"""Arguments that passed, or met an error of another library: each is named."""

import math

import numpy as np
import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import Independent, KMeansCondition, combine
from cotlearn.datasets import Dataset
from cotlearn.diagnostics.regression import regression
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.robots.episodes import read

X = torch.randn(6, 2, generator=seeded())
NET, BARE = VelocityMLP(2, 3, width=8, depth=1, seed=0), VelocityMLP(2, width=8, depth=1, seed=0)
C = torch.zeros(6, 3)


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
