"""Wrong arguments at the documented doors: each is refused by name, none gives a wrong number."""

import math
import re

import numpy as np
import pytest
import torch
from torch.utils.data import TensorDataset

from cotlearn import couplings, datasets, diagnostics, flows, metrics, mixtures, potentials
from cotlearn.couplings import ConditionalOT, MinibatchOT, SemidiscreteOT, StratifiedOT
from cotlearn.course.kernel import Limits
from cotlearn.datasets import Dataset
from cotlearn.gaussian import LinearGaussian
from cotlearn.mixtures import petals
from cotlearn.policies.options import Options
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.samplers import DDIMSampler, DDPMSampler, FlowSampler
from cotlearn.policies.training import train
from cotlearn.policies.windows import Windows
from cotlearn.report import examine, from_arrays
from cotlearn.robots.arm import ArmVectorSim, solve
from cotlearn.robots.arm.environment import Arm
from cotlearn.robots.arm.kinematics import forward
from cotlearn.robots.episodes import Episodes, split
from cotlearn.robots.push_t import PUSH_T, PushTVectorSim
from cotlearn.robots.push_t.environment import PushT
from cotlearn.robots.push_t.geometry import corners, coverage
from cotlearn.robots.push_t.rasteriser import rasterise
from cotlearn.robots.registry import find_task

X, C = petals().sample(200, generator=torch.Generator().manual_seed(0))
DATA, NET = Dataset(X, C), flows.VelocityMLP(2, 4, width=8, depth=1, seed=0)
NUMPY = np.random.default_rng(0)
NAN = torch.full((200, 2), math.nan)
SCENES = np.tile([200.0, 200.0, 256.0, 256.0, 0.5], (3, 1))
EPISODES = Episodes(SCENES, SCENES[:, :2], np.array([1, 3]), PUSH_T)
WINDOWS = Windows(
    task=find_task("push-t"),
    frame="body",
    observation_range=np.array([[-1.0] * 6, [1.0] * 6]),
    action_range=np.array([[-1.0] * 2, [1.0] * 2]),
)
RESIDUAL = flows.networks.ResidualMLP(WINDOWS.dim, WINDOWS.condition_dim, width=8, blocks=1)
POLICY = ChunkPolicy(RESIDUAL, WINDOWS, FlowSampler(1))


def split_seeds(seeds):
    return PushTVectorSim.from_seeds(seeds), ArmVectorSim.from_seeds(seeds)


def fit(**options):
    return flows.fit(NET, DATA, MinibatchOT(), **({"steps": 1, "batch_size": 8} | options))


CALLS = {
    # silently wrong before
    "values": [
        lambda: metrics.bootstrap_interval([1.0, math.nan]),
        lambda: metrics.bootstrap_interval([1j, 2]),
    ],
    "iterations": [lambda: SemidiscreteOT(iterations=-1)],
    "pose": [lambda: coverage([math.nan] * 3), lambda: corners([0, 0, math.nan])],
    "joints": [lambda: forward(np.full((1, 7), np.nan))],
    "targets": [lambda: solve(np.full((1, 3), np.nan)), lambda: solve(np.zeros(3))],
    "start": [lambda: solve(np.ones((1, 3)), np.full((1, 7), np.nan))],
    "states": [
        *(lambda s=s: rasterise(s) for s in (NAN, SCENES * np.nan, SCENES[0], SCENES[:, :4])),
        lambda: PushTVectorSim(SCENES * np.nan),
        lambda: ArmVectorSim(SCENES, "ring"),
    ],
    "size": [lambda: rasterise(SCENES, size=0)],
    "kind": [lambda: ArmVectorSim.from_seeds([0], "square")],
    "rows": [lambda: datasets.Standardiser.fit(NAN), lambda: examine(DATA)],
    "residual": [lambda: StratifiedOT(residual="no")],
    "regularization": [lambda r=r: couplings.ModelAligned(regularization=r) for r in ((1.0,), 5)],
    "inner": [lambda: couplings.EmbeddedClusters(torch.sin, 5)],
    "x0": [lambda: couplings.FixedPairs(X.numpy())],
    "coupling": [
        lambda: couplings.Transformed(MinibatchOT, lambda x, c: x),
        lambda: diagnostics.deployment_gap(NET, DATA, 5),
    ],
    "couplings": [lambda: diagnostics.frontier(X, C, MinibatchOT())],
    "oracle": [lambda: diagnostics.error_budget(NET, petals(), 5, nfe=1)],
    "network": [lambda: flows.velocity_of(5)],
    "true_map": [lambda: potentials.KnownMap(5, 2)],
    "dim": [lambda: potentials.KnownMap(torch.sin, 0), lambda: potentials.KnownMap.gaussian(0)],
    "potential": [
        lambda: potentials.OptimalField(5),
        lambda: potentials.OptimalAction(5),
        lambda: potentials.transport(5, X),
        lambda: potentials.invert(NET, X),
        lambda: potentials.dual_objective(NET, X, X),
    ],
    "rng": [lambda: LinearGaussian.example().sample(3, torch.Generator())],
    "n": [
        lambda: mixtures.spread_conditions(0),
        lambda: mixtures.uniform_conditions(-1),
        lambda: DATA.conditions(-1),
        lambda: POLICY.noise(-1),
    ],
    "seeds": [
        call
        for seeds in (3, [], "3", [1.5], ["3"], [-1], torch.tensor([1]))
        for call in (lambda s=seeds: rollout(POLICY, seeds=s), lambda s=seeds: split_seeds(s))
    ],
    "policy": [lambda: rollout(5)],
    "sampler": [lambda: ChunkPolicy(RESIDUAL, WINDOWS, 5)],
    "noise": [lambda: POLICY.act(SCENES[:, None].repeat(2, 1), noise=NAN[:96].reshape(1, 3, 64))],
    "repetitions": [lambda: POLICY.latency(repetitions=-1)],
    "nfe": [lambda: FlowSampler(0), lambda: DDIMSampler(0), lambda: flows.sampler(NET, nfe=0)],
    "method": [lambda: FlowSampler(1, "rk9")],
    "levels": [lambda: DDPMSampler(0), lambda: DDPMSampler(2.5)],
    "learning_rate": [lambda: Options(learning_rate=-1)],
    "ema": [lambda: Options(ema=2)],
    "episodes": [lambda: train("independent", X), lambda: split(5, held_out=1)],
    "index": [lambda i=i: EPISODES.select(i) for i in ([9], [0.5], "a")],
    "task": [lambda: Episodes(SCENES, SCENES[:, :2], np.array([3]), "push-t")],
    "seconds": [lambda s=s: Limits(seconds=s) for s in ("60", 0, math.inf)],
    "data": [
        lambda: datasets.unconditional(5),
        lambda: next(MinibatchOT().stream(Dataset, batch_size=8)),
        lambda: metrics.conditional_squared_w2(flows.sampler(NET, nfe=1), X),
    ],
    "resamples": [lambda: metrics.bootstrap_interval([1, 2], resamples=-1)],
    "group": [lambda: from_arrays(X, C, group=np.arange(199))],
    "seed": [
        call
        for seed in (1.5, "3", -1, torch.tensor(1))
        for call in (
            lambda s=seed: metrics.bootstrap_interval([1, 2], seed=s),
            lambda s=seed: metrics.paired_bootstrap([[1, 2]], [[1, 3]], seed=s),
            lambda s=seed: diagnostics.between_within(X, C, seed=s),
            lambda s=seed: diagnostics.recommend(X, C, seed=s),
            lambda s=seed: diagnostics.frontier(X, C, {"a": MinibatchOT()}, seed=s),
            lambda s=seed: flows.VelocityMLP(2, seed=s),
            lambda s=seed: fit(seed=s),
            lambda s=seed: PushT().reset(seed=s),
            lambda s=seed: Arm().reset(seed=s),
            lambda s=seed: potentials.eight_gaussians_map(4, seed=s),
        )
    ],
    # functions that are numbers
    "velocity": [
        lambda: flows.integrate(5, X, C, nfe=1),
        lambda: flows.sampler(5, nfe=1, dim=2),
        lambda: metrics.straightness(5, X, C),
        lambda: flows.Guided(5, 2.0),
    ],
    "sample": [lambda: metrics.conditional_squared_w2(5, DATA)],
    "loss": [lambda: fit(loss=5)],
    "source": [lambda: fit(source=5), lambda: fit(source=5, checkpoint="never.safetensors")],
    "generator": [
        lambda: MinibatchOT()(X, X, generator=NUMPY),
        lambda: next(MinibatchOT().stream(DATA, batch_size=8, generator=0)),
        lambda: DATA.sample(3, generator=NUMPY),
        lambda: DATA.sample_given(C, generator=0),
        lambda: petals().sample(3, generator=NUMPY),
        lambda: petals().sample_given(C, generator=NUMPY),
        lambda: diagnostics.prior_skew(X, C, generator=NUMPY),
        lambda: flows.sampler(NET, nfe=1)(C, generator=NUMPY),
        lambda: POLICY.noise(3, generator=NUMPY),
        lambda: mixtures.uniform_conditions(3, generator=NUMPY),
        lambda: potentials.KnownMap.gaussian(2).sample(3, generator=NUMPY),
        lambda: potentials.ConditionalGaussian().sample_given(X[:, :1], generator=NUMPY),
    ],
    "x1": [lambda: Dataset(X.clone().requires_grad_(), C)],
    "plan": [lambda: MinibatchOT(plan=np.array(["exact", "sinkhorn"]))],
    "batch_size": [
        lambda: fit(batch_size=torch.tensor(8)),
        *(lambda b=b: Options(batch_size=b) for b in (0, 2.5)),
    ],
    "checkpoint": [lambda p=p: fit(checkpoint=p) for p in (".", "/dev/null/a.safetensors", 5)],
}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_refused_by_name(name):
    for number, call in enumerate(CALLS[name]):
        with pytest.raises((TypeError, ValueError)) as refused:
            call()
        said = rf"\b{name}\b.* got |{name} (has|have|is|cannot|must) "
        assert re.search(said, str(refused.value)), f"{number}: {refused.value}"


def test_the_energy_score_of_large_numbers_is_a_number():
    truth = torch.full((3, 2), 1e19)
    samples = torch.stack([truth, -truth])
    assert metrics.energy_score(samples, truth) == pytest.approx(0, abs=1e13)
    assert metrics.energy_score(-samples.abs(), truth) == pytest.approx(math.sqrt(8) * 1e19)


def test_images_are_refused_with_advice():
    images = torch.zeros(8, 1, 8, 8)
    advice = r"x0\.flatten\(1\); images\[pairs\.target_index\]"
    said = r"x0 must have shape .*got \(8, 1, 8, 8\); pass " + advice
    with pytest.raises(ValueError, match=said):
        MinibatchOT()(images, images)
    with pytest.raises(ValueError, match=r"x1 must have .* pass x1\.flatten\(1\)$"):
        Dataset(images)


def test_an_infinite_weight_is_a_number():
    with pytest.raises(ValueError, match=r"condition_weight must be a number .*math\.inf.*'inf'"):
        ConditionalOT("inf")


@pytest.mark.parametrize("coupling", [MinibatchOT(), StratifiedOT()])
def test_a_tensor_dataset_is_not_called_endless(coupling):
    with pytest.raises(TypeError, match=r"data must .*Dataset\(x1, c\), got <.*TensorD"):
        next(coupling.stream(TensorDataset(X, C), batch_size=8))


def test_stratified_ot_says_that_a_batch_has_its_own_strata(recwarn):
    coupling = StratifiedOT()
    next(coupling.stream(DATA, batch_size=8))
    assert not recwarn
    for k in (coupling, StratifiedOT()):  # after a stream, too: a call has none of its clusters
        with pytest.warns(UserWarning, match=r"called with 200 rows.*stream\(Dataset\(x1, c\)"):
            k(X, X, C)
        recwarn.clear()
        k(X, X, C)
        assert not recwarn
