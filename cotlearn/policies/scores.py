"""Scores of a trained policy beside its success: held-out demonstrations, and modes."""

import numpy as np
import torch
from numpy.typing import NDArray

from cotlearn.datasets import Dataset
from cotlearn.metrics import energy_score
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import COUNTED, rollout
from cotlearn.randomness import Purpose, generator_for

SCORED_STATES, SCORED_SAMPLES = 1000, 8  #: of the energy score
MODE_STARTS, MODE_DRAWS = 25, 16


def held_out_score(policy: ChunkPolicy, held: Dataset) -> float:
    """The energy score of chunks at held-out states, in the units that the network works in."""
    return energy_score(*held_out_draws(policy, held))


def held_out_draws(policy: ChunkPolicy, held: Dataset) -> tuple[torch.Tensor, torch.Tensor]:
    """Chunks (SCORED_SAMPLES, B, d) at B held-out states, and the true ones (B, d)."""
    assert held.c is not None
    rng = generator_for(0, 0, Purpose.HELD_OUT_CHUNKS)
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
