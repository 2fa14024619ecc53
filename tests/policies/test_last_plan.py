"""The last plans of `benchmarks/last_plan.py`, with a trained policy."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cotlearn.assets import find_data
from cotlearn.flows.networks import ResidualMLP
from cotlearn.flows.one_step.mean_velocity import MeanVelocity
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.samplers import JumpSampler

ROOT = Path(__file__).resolve().parents[2]

LastPlan = runpy.run_path(str(ROOT / "benchmarks/last_plan.py"))["LastPlan"]


@pytest.fixture(scope="module")
def policy():
    loaded = ChunkPolicy.load(find_data("weights/push_t_residual.safetensors"))
    return replace(loaded, execute=4)


def plans(policy, n=3):
    """What a policy executes in two plans of n episodes, and both whole plans."""
    state = policy.windows.task.vector_sim(range(n)).states
    history = np.repeat(state[:, None], policy.windows.observe, axis=1)
    executed, whole = [], []
    for seed in (0, 1):
        noise = policy.noise(n, torch.Generator().manual_seed(seed))
        executed.append(policy.act(history, noise=noise))
        whole.append(policy.plans.copy())
    return executed, whole


@pytest.mark.parametrize("jumps", [False, True])
@pytest.mark.parametrize("nfe", [1, 2])
def test_without_last_plans_it_is_the_policy(policy, nfe, jumps):
    drawn = policy.with_sampler(replace(policy.sampler, nfe=nfe))
    if jumps:  # of a network that predicts the chunk, without training
        wide = policy.windows.condition_dim + 1  # with the length of a jump
        network = MeanVelocity(ResidualMLP(policy.windows.dim, condition_dim=wide, seed=0))
        drawn = replace(drawn, network=network, sampler=JumpSampler(nfe, prediction="data"))
    kept = {"episodes": 4, "max_steps": 20, "progress": False, "record": True}
    mine, theirs = rollout(LastPlan(drawn, 0.0), **kept), rollout(drawn, **kept)
    np.testing.assert_allclose(mine.states, theirs.states, atol=1e-4)


def test_a_mean_of_plans_is_executed(policy):
    executed, (first, second) = plans(LastPlan(policy, 0.0, older=0.5))
    mean = (0.5 * first[:, 4:8] + second[:, :4]) / 1.5
    np.testing.assert_allclose(executed[0], first[:, :4])
    np.testing.assert_allclose(executed[1], mean)


def test_a_late_start_stays_near_the_last_plan(policy):
    _, (first, second) = plans(LastPlan(policy, 0.9), n=20)
    left = np.concatenate([first[:, 4:], np.repeat(first[:, -1:], 4, axis=1)], axis=1)
    _, (_, fresh) = plans(LastPlan(policy, 0.0), n=20)
    assert abs(second - left).mean() < 0.8 * abs(fresh - left).mean()
