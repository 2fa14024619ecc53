"""How far do two choices that nobody reports move a MeanFlow with the paper's weights?

The constant in its weights, 0.01 in the authors' code and 0.001 in their text; and whether the time
that the network is given counts from the noise or from the data. Petals, one evaluation,
independent pairs, at the cost of `benchmarks/one_step.py`.

    python benchmarks/mean_flow_choices.py
"""

from itertools import product
from typing import Any

import torch
from cells import opened
from one_step import BATCH, SIZES, STEPS, rows_of, score_of
from torch import Tensor, nn

from cotlearn.couplings import Independent
from cotlearn.flows import VelocityMLP, fit, matching
from cotlearn.flows.one_step import MeanFlow, MeanVelocity, jump

CONSTANTS, ORIGINS, SEEDS = (0.001, 0.01), ("noise", "data"), range(3)


class FromData(nn.Module):
    """A network that is given 1 - t in the place of t."""

    def __init__(self, network: Any) -> None:
        super().__init__()
        self.network, self.dim = network, network.dim
        self.condition_dim = network.condition_dim

    def forward(self, t: Tensor, x: Tensor, c: Tensor) -> Tensor:
        """What the network says, (B, d)."""
        return self.network(1 - t, x, c)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """Squared W2 of a training."""
    matching.SOFTENING = key["constant"]
    data, seed = rows_of("petals", key["seed"]), key["seed"]
    plain: Any = VelocityMLP(data.dim, data.condition_dim + 1, seed=seed, **SIZES)
    network = MeanVelocity(FromData(plain) if key["time_from"] == "data" else plain)
    options: dict[str, Any] = {**BATCH, "loss": MeanFlow(), "seed": seed, "progress": False}
    found: Any = fit(network, data, Independent(), steps=int(STEPS * 3 / 4), **options).network

    def sample(c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        return jump(found, torch.randn(len(c), data.dim, generator=generator), c, nfe=1)

    return {"squared_w2": score_of("petals", sample, seed)}


def main() -> None:
    """Fills the table."""
    table = opened(__doc__ or "", {"steps": STEPS, "data": "petals", **BATCH, **SIZES})
    cells = product(CONSTANTS, ORIGINS, SEEDS)
    names = ("constant", "time_from", "seed")
    table.fill([dict(zip(names, cell, strict=True)) for cell in cells], compute)


if __name__ == "__main__":
    main()
