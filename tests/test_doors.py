"""Wrong arguments at the documented doors: each is refused by name, none gives a wrong number."""

import math
import re

import numpy as np
import pytest
import torch
from torch.utils.data import TensorDataset

from cotlearn import diagnostics, flows, metrics
from cotlearn.couplings import ConditionalOT, MinibatchOT, SemidiscreteOT, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.mixtures import petals
from cotlearn.report import from_arrays
from cotlearn.robots.arm.kinematics import forward
from cotlearn.robots.push_t.geometry import corners, coverage

X, C = petals().sample(200, generator=torch.Generator().manual_seed(0))
DATA, NET = Dataset(X, C), flows.VelocityMLP(2, 4, width=8, depth=1, seed=0)
NUMPY = np.random.default_rng(0)
MASKED = np.ma.masked_equal([1.0, 2.0, -9999.0], -9999.0)


def fit(**options):
    return flows.fit(NET, DATA, MinibatchOT(), **({"steps": 1, "batch_size": 8} | options))


CALLS = {
    # silently wrong before
    "values": [
        lambda: metrics.bootstrap_interval(MASKED),
        lambda: metrics.bootstrap_interval(np.array([1, 2], "M8[s]")),
        lambda: metrics.bootstrap_interval([1j, 2]),
    ],
    "iterations": [lambda: SemidiscreteOT(iterations=-1)],
    "pose": [lambda: coverage([math.nan] * 3), lambda: corners([0, 0, math.nan])],
    "joints": [lambda: forward(np.full((1, 7), np.nan))],
    "resamples": [lambda: metrics.bootstrap_interval([1, 2], resamples=-1)],
    "group": [lambda: from_arrays(X, C, group=np.ma.masked_equal(np.arange(200), 3))],
    "seed": [
        call
        for seed in (1.5, "3", -1, 10**400, torch.tensor(1))
        for call in (
            lambda s=seed: metrics.bootstrap_interval([1, 2], seed=s),
            lambda s=seed: metrics.paired_bootstrap([[1, 2]], [[1, 3]], seed=s),
            lambda s=seed: diagnostics.between_within(X, C, seed=s),
            lambda s=seed: diagnostics.recommend(X, C, seed=s),
            lambda s=seed: diagnostics.frontier(X, C, {"a": MinibatchOT()}, seed=s),
            lambda s=seed: flows.VelocityMLP(2, seed=s),
            lambda s=seed: fit(seed=s),
        )
    ],
    # functions that are numbers
    "velocity": [
        lambda: flows.integrate(5, X, C, nfe=1),
        lambda: flows.sampler(5, nfe=1, dim=2),
        lambda: metrics.straightness(5, X, C),
    ],
    "sample": [lambda: metrics.conditional_squared_w2(5, DATA)],
    "loss": [lambda: fit(loss=5)],
    "source": [lambda: fit(source=5)],
    "generator": [
        lambda: MinibatchOT()(X, X, generator=NUMPY),
        lambda: next(MinibatchOT().stream(DATA, batch_size=8, generator=0)),
        lambda: DATA.sample(3, generator=NUMPY),
        lambda: DATA.sample_given(C, generator=0),
        lambda: petals().sample(3, generator=NUMPY),
        lambda: petals().sample_given(C, generator=NUMPY),
        lambda: diagnostics.prior_skew(X, C, generator=NUMPY),
        lambda: flows.sampler(NET, nfe=1)(C, generator=NUMPY),
    ],
    "x1": [lambda: Dataset(X.clone().requires_grad_(), C)],
    "plan": [lambda: MinibatchOT(plan=np.array(["exact", "sinkhorn"]))],
    "batch_size": [lambda: fit(batch_size=torch.tensor(8)), lambda: fit(batch_size=10**400)],
    "checkpoint": [lambda: fit(checkpoint="."), lambda: fit(checkpoint="/dev/null/a.safetensors")],
}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_refused_by_name(name):
    for number, call in enumerate(CALLS[name]):
        with pytest.raises((TypeError, ValueError)) as refused:
            call()
        assert re.search(rf"\b{name}\b.* got |{name} has masked", str(refused.value)) or (
            name in {"pose", "joints", "checkpoint"} and name in str(refused.value)
        ), f"{number}: {refused.value}"


def test_the_energy_score_of_large_numbers_is_a_number():
    truth = torch.full((3, 2), 1e19)
    samples = torch.stack([truth, -truth])
    assert metrics.energy_score(samples, truth) == pytest.approx(0, abs=1e13)
    assert metrics.energy_score(-samples.abs(), truth) == pytest.approx(math.sqrt(8) * 1e19)


def test_images_are_refused_with_advice():
    images = torch.zeros(8, 1, 8, 8)
    advice = r"x0\.flatten\(1\); images\[pairs\.target_index\]"
    with pytest.raises(
        ValueError, match=r"x0 must have shape .*got \(8, 1, 8, 8\); pass " + advice
    ):
        MinibatchOT()(images, images)
    with pytest.raises(ValueError, match=r"x1 must have .* pass x1\.flatten\(1\)$"):
        Dataset(images)


def test_an_infinite_weight_is_a_number():
    with pytest.raises(ValueError, match=r"condition_weight must be a number .*math\.inf.*'inf'"):
        ConditionalOT("inf")


@pytest.mark.parametrize("coupling", [MinibatchOT(), StratifiedOT()])
def test_a_tensor_dataset_is_not_called_endless(coupling):
    with pytest.raises(TypeError, match=r"data must .*Dataset\(x1, c\) has; got TensorD"):
        next(coupling.stream(TensorDataset(X, C), batch_size=8))


def test_stratified_ot_says_that_a_batch_has_its_own_strata(recwarn):
    coupling = StratifiedOT()
    next(coupling.stream(DATA, batch_size=8))
    coupling(X, X, C)
    assert not recwarn
    with pytest.warns(UserWarning, match=r"called with 200 rows.*stream\(Dataset\(x1, c\)"):
        StratifiedOT()(X, X, C)
