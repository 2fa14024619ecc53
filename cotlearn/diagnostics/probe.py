"""A probe: learn one Euler step from some pairs in a second, and score its samples."""

from dataclasses import replace
from operator import itemgetter
from typing import Any

import torch
from torch import Tensor

from cotlearn.couplings.base import Batches, Pairs
from cotlearn.couplings.distances import to_numpy
from cotlearn.couplings.units import TamedStandardiser
from cotlearn.diagnostics.regression import regression
from cotlearn.flows.matching import squared_error
from cotlearn.flows.networks import VelocityMLP
from cotlearn.flows.training import fit
from cotlearn.metrics import energy_scores
from cotlearn.randomness import Purpose, generator_for

WIDTH, DEPTH, BATCH = 128, 2, 256  #: of the probe
DRAWS, MOST_ROWS = 8, 1000  #: samples for each held-out row; most held-out rows
MOST_FITTED = 4000  #: rows of a regression


def one_step_scores(pairs: Any, test: Any, *, steps: int = 500, seed: int = 0) -> Tensor:
    """Energy score of one-step samples for each held-out row; lower is better.

    One Euler step returns x0 + v(0, x0, c), for which E[x1 - x0 | x0, c] is the best v. A small
    network learns this v from the pairs in about a second. Unlike nearest neighbours it needs no
    near rows, so it also works in dozens of dimensions. It is then evaluated as at test time, with
    fresh noise and unseen conditions, so that prior skew worsens its score.

    Args:
        pairs: `Pairs` of a coupling, a few thousand, with conditions.
        test: held-out `Dataset`.
        steps: gradient steps.
        seed: of the network, its training and the noise.

    Returns:
        Scores (n,) of at most 1,000 held-out rows, the same rows for every coupling.
    """
    scaler = TamedStandardiser.fit(pairs.c)
    shown = replace(pairs, c=scaler(pairs.c))
    rng = generator_for(seed, 0, Purpose.PROBE)
    batches_of = torch.randint(len(pairs), (steps, BATCH), generator=rng)
    made = VelocityMLP(test.dim, test.condition_dim, width=WIDTH, depth=DEPTH, seed=seed)
    batches = Batches(shown.map(itemgetter(some)) for some in batches_of)
    options: Any = {"steps": steps, "batch_size": BATCH, "loss": _first_step, "ema": 0.0}
    network = fit(made.to(pairs.x0), test, batches, **options, progress=False).network
    rows = _scored(test, rng)
    c, drawn = scaler(test.c[rows]), []
    with torch.no_grad():
        for _ in range(DRAWS):
            noise = torch.randn(len(rows), test.dim, generator=rng, dtype=pairs.x0.dtype)
            drawn.append(noise + network(0.0, noise, c))
    return energy_scores(torch.stack(drawn), test.x1[rows])


def regression_scores(train: Any, test: Any, *, steps: int = 500, seed: int = 0) -> Tensor:
    """Energy score of a regression, which predicts a point for each held-out row; lower is better.

    It is the distance |E[x1 | c] - x1|. A regression has no spread, so it wins only where the data
    hardly vary given the condition, or where there are too few rows to learn how.

    Args:
        train: `Dataset` with conditions; of more than 4,000 rows, 4,000 are drawn.
        test: held-out `Dataset`.
        steps: of the probes to compare with.
        seed: of the probes to compare with.

    Returns:
        Scores (n,) of the rows that `one_step_scores` with these steps and this seed scores.
    """
    rng = generator_for(seed, 0, Purpose.PROBE)
    torch.randint(1, (steps, BATCH), generator=rng)  # a probe draws its batches first
    rows = _scored(test, rng)
    some = torch.randperm(len(train), generator=rng)[:MOST_FITTED]
    predict = regression(to_numpy(train.x1[some]), to_numpy(train.c[some]), seed=seed)
    made = torch.from_numpy(predict(to_numpy(test.c[rows])))
    return energy_scores(torch.stack([made, made]), test.x1[rows])


def _scored(test: Any, rng: torch.Generator) -> Tensor:
    """The held-out rows that are scored."""
    return torch.randperm(len(test), generator=rng)[:MOST_ROWS]


def _first_step(network: Any, pairs: Pairs, generator: torch.Generator) -> Tensor:
    """Squared error of the velocity at t = 0 for each row, (B,)."""
    return squared_error(network(0.0, pairs.x0, pairs.c), pairs.x1 - pairs.x0)
