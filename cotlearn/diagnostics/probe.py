"""The first Euler step, learned in a second: what a one-step model would make of these pairs."""

from __future__ import annotations

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs, generator_for
from cotlearn.datasets import Dataset, Standardiser
from cotlearn.flows.networks import VelocityMLP
from cotlearn.metrics import energy_scores

WIDTH, DEPTH, BATCH, LEARNING_RATE = 128, 2, 256, 2e-3  #: of the probe
DRAWS, MOST_ROWS = 8, 1000  #: samples for each held-out condition, and such conditions


def one_step_scores(pairs: Pairs, test: Dataset, *, steps: int = 500, seed: int = 0) -> Tensor:
    """Energy score of one-step samples for each held-out row; small is good.

    One Euler step says x0 + v(0, x0, c), and the best v there is E[x1 - x0 | x0, c]. A small
    network learns just that from the pairs, which takes about a second and, unlike nearest
    neighbours, needs no near rows: it also works in dozens of dimensions. It is then asked as a
    user would, with fresh noise at conditions that it has not seen, so that it pays for skew.

    Args:
        pairs: of the coupling, a few thousand, with conditions.
        test: held-out data.
        steps: of training, with Adam and a learning rate that falls to 0.
        seed: of the network, its training and the noise.

    Returns:
        Scores (n,), of at most 1,000 rows of the held-out data, the same rows for every coupling.
    """
    assert pairs.c is not None
    assert test.c is not None
    scaler = Standardiser.fit(pairs.c)
    x0, c = pairs.x0, scaler(pairs.c)
    wanted = pairs.x1 - x0
    network = VelocityMLP(x0.shape[1], c.shape[1], width=WIDTH, depth=DEPTH, seed=seed).to(x0)
    optimizer = torch.optim.Adam(network.parameters(), lr=LEARNING_RATE, fused=True)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    rng = generator_for(seed, 0, purpose=13)
    for rows in torch.randint(len(x0), (steps, BATCH), generator=rng):
        loss = (network(0.0, x0[rows], c[rows]) - wanted[rows]).square().sum(dim=1).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        schedule.step()
    rows = torch.randperm(len(test), generator=rng)[:MOST_ROWS]
    c = scaler(test.c)[rows]
    drawn = []
    with torch.no_grad():
        for _ in range(DRAWS):
            noise = torch.randn(len(rows), test.dim, generator=rng, dtype=x0.dtype)
            drawn.append(noise + network(0.0, noise, c))
    return energy_scores(torch.stack(drawn), test.x1[rows])
