"""A Push-T policy trained for a while and rolled out, for the benchmarks of single choices."""

from dataclasses import replace
from typing import Any

from cotlearn.metrics import bootstrap_interval
from cotlearn.policies.methods import Method
from cotlearn.policies.rollout import EXPLORATION, rollout
from cotlearn.policies.samplers import FlowSampler
from cotlearn.policies.training import Options, Trained, train
from cotlearn.robots.episodes import Episodes

EVALUATIONS = (1, 2, 16)


def train_and_roll(
    method: str | Method,
    training: Episodes,
    options: Options,
    *,
    seed: int,
    rollouts: int,
    first_seed: int = EXPLORATION,
) -> dict[str, Any]:
    """Coverage and success of each sampler, coverage's interval over episodes, and the seconds."""
    trained = train(method, training, seed=seed, options=options)
    return rolled(trained, rollouts=rollouts, first_seed=first_seed)


def rolled(trained: Trained, *, rollouts: int, first_seed: int = EXPLORATION) -> dict[str, Any]:
    """What `train_and_roll` says of a policy that is trained already."""
    policy = trained.policy
    assert isinstance(policy.sampler, FlowSampler)
    seeds = range(first_seed, first_seed + rollouts)
    done = {
        f"euler-{nfe}": rollout(policy.with_sampler(replace(policy.sampler, nfe=nfe)), seeds=seeds)
        for nfe in EVALUATIONS
    }
    coverage = {name: one["coverage"] for name, one in done.items()}
    return {
        "coverage": {name: float(values.mean()) for name, values in coverage.items()},
        "interval": {name: bootstrap_interval(values) for name, values in coverage.items()},
        "success": {name: float(one["success_95"].mean()) for name, one in done.items()},
        "parameters": trained.parameters,
        "training_seconds": trained.seconds,
    }
