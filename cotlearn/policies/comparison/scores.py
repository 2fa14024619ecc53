"""Evaluation of a trained policy: rollouts, energy score, modes, latency."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from cotlearn.couplings.base import generator_for
from cotlearn.datasets import Dataset
from cotlearn.metrics import energy_score, mode_entropy
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import COUNTED, rollout

SCORED_STATES, SCORED_SAMPLES = 1000, 8  #: of the energy score
MODE_STARTS, MODE_DRAWS = 25, 16
TRIALS = 100  #: rollouts that choose a temperature


def evaluate(policy: ChunkPolicy, held: Dataset, *, starts: Sequence[int]) -> dict[str, Any]:
    """Rollouts, energy score, modes and latency of a policy with its sampler, JSON-compatible."""
    done = rollout(policy, seeds=starts)
    derived = {"mode", *done.task.thresholds, *done.task.capped}
    kept = [name for name in done.outcomes if name not in derived]
    return {
        "nfe": policy.sampler.nfe,
        "summary": done.summary(),
        "energy_score": held_out_score(policy, held),
        "mode_entropy": mode_entropy(mode_draws(policy)),
        "latency_ms": 1000 * policy.latency(),
        "seconds_of_policy": done.seconds,
        "chunks": done.chunks,
        "outcomes": {name: [rounded_up(value) for value in done[name]] for name in kept},
        "steps": done.steps.tolist(),
    }


def rounded_up(value: float) -> float:
    """To six digits, so that what is above a threshold stays above it."""
    return math.ceil(round(float(value) * 1e6, 3)) / 1e6


def choose_temperature(
    policy: ChunkPolicy, temperatures: Sequence[float]
) -> tuple[float, dict[str, float]]:
    """The temperature, among `temperatures` and 1, with most successes on exploration starts.

    Success is the strictest outcome of the task; ties are broken by the task's score.

    Returns:
        The temperature, and the success rate of each.
    """
    task = policy.windows.task
    found = {}
    for temperature in (1.0, *temperatures):
        means = rollout(replace(policy, temperature=temperature), episodes=TRIALS).summary()
        found[temperature] = means[task.strictest], means[task.score]
    best = max(found, key=lambda temperature: found[temperature])
    return best, {f"{temperature:g}": strict for temperature, (strict, _) in found.items()}


def held_out_score(policy: ChunkPolicy, held: Dataset) -> float:
    """The energy score of chunks at held-out states, in the units that the network works in."""
    return energy_score(*held_out_draws(policy, held))


def held_out_draws(policy: ChunkPolicy, held: Dataset) -> tuple[torch.Tensor, torch.Tensor]:
    """Chunks (SCORED_SAMPLES, B, d) at B held-out states, and the true ones (B, d)."""
    assert held.c is not None
    rng = generator_for(0, 0, purpose=17)
    rows = torch.randperm(len(held), generator=rng)[:SCORED_STATES]
    c = held.c[rows]
    draws = [policy.draw(policy.noise(len(rows), rng), c) for _ in range(SCORED_SAMPLES)]
    return torch.stack(draws), held.x1[rows]


def mode_draws(policy: ChunkPolicy) -> NDArray[np.int64]:
    """The modes (MODE_STARTS, MODE_DRAWS) that a policy takes from the same starts."""
    seeds = np.repeat(np.arange(COUNTED, COUNTED + MODE_STARTS), MODE_DRAWS)
    steps = policy.windows.task.mode_steps
    done = rollout(policy, seeds=seeds.tolist(), max_steps=steps, progress=False)
    return done["mode"].astype(np.int64).reshape(MODE_STARTS, MODE_DRAWS)
