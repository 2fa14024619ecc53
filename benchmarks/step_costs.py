"""What does a gradient step cost, by the clock, for each loss of one evaluation?

Elsewhere costs are counted in forward passes. Here they are measured: loss, gradient and a step of
Adam for a batch of 256 rows, on one core of a quiet machine, for the networks of three comparisons.
The faster fifth of ROUNDS ends at the time that is stored, since other programs only slow it.

    python benchmarks/step_costs.py
"""

import time
from collections.abc import Callable
from typing import Any

import torch
from cells import opened

from cotlearn.couplings import Independent
from cotlearn.flows import FlowMatching, VelocityMLP
from cotlearn.flows.diffusion import regression_loss
from cotlearn.flows.networks import ResidualMLP
from cotlearn.flows.one_step import (
    AlphaFlow,
    Drifting,
    MeanFlow,
    MeanVelocity,
    Shortcut,
    TwoPasses,
)

BATCH, ROUNDS = 256, 100
#: Columns of the data and of the condition, and the network, as in the comparisons.
NETWORKS: dict[str, tuple[int, int, Callable[[int, int], Any]]] = {
    "plane": (2, 4, lambda d, k: VelocityMLP(d, k, width=128, depth=3)),
    "arm": (30, 24, lambda d, k: ResidualMLP(d, k, width=256)),
    "push-t": (32, 10, lambda d, k: ResidualMLP(d, k, width=384)),
}
#: The loss, and the cost of a row that is counted, in units of flow matching.
LOSSES: dict[str, tuple[Any, float]] = {
    "flow matching": (FlowMatching(), 1.0),
    "regression": (regression_loss, 1.0),
    "shortcut model": (Shortcut(share=0.25), 7 / 6),
    "alpha-flow": (AlphaFlow(1000), 4 / 3),
    "MeanFlow": (MeanFlow(uniform=True), 4 / 3),
    "two passes (MIP)": (TwoPasses(), 2.0),
    "drifting": (Drifting(4), 4.0),
}


def milliseconds(loss: Any, network: Any, d: int, k: int) -> float:
    """Of a step, the slower four fifths left out."""
    g = torch.Generator().manual_seed(0)
    x0, x1, c = (torch.randn(BATCH, n, generator=g) for n in (d, d, k))
    pairs = Independent()(x0, x1, c)
    optimizer = torch.optim.Adam(network.parameters())
    spent = []
    for _ in range(ROUNDS):
        started = time.perf_counter()
        optimizer.zero_grad()
        loss(network, pairs, g).mean().backward()
        optimizer.step()
        spent.append(1000 * (time.perf_counter() - started))
    return sorted(spent)[ROUNDS // 5]


def measure(key: dict[str, Any]) -> dict[str, Any]:
    """Milliseconds, and in units of flow matching: counted, and measured."""
    d, k, make = NETWORKS[key["network"]]
    found = {}
    for name, (loss, _) in LOSSES.items():
        jumps = isinstance(loss, AlphaFlow | MeanFlow | Shortcut)
        network = make(d, k + jumps)
        network = MeanVelocity(network) if jumps else network
        found[name] = milliseconds(loss, network, d, k)
    flow = found["flow matching"]
    return {
        "milliseconds": {name: round(value, 2) for name, value in found.items()},
        "counted": {name: round(counted, 2) for name, (_, counted) in LOSSES.items()},
        "measured": {name: round(value / flow, 2) for name, value in found.items()},
    }


def main() -> None:
    """Fill the table."""
    table = opened(__doc__ or "", {"batch": BATCH, "rounds": ROUNDS})
    table.fill([{"network": name} for name in NETWORKS], measure)


if __name__ == "__main__":
    main()
