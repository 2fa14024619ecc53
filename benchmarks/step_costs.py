"""What does a gradient step cost, in time of a core, for each loss of one evaluation?

Elsewhere costs are counted in forward passes. Here they are measured: loss, gradient and a step of
Adam for a batch of 256 rows, in seconds of one core, for the networks of three comparisons. The
losses take turns, and the faster fifth of ROUNDS ends at the time that is stored, since other
programs only slow it. Drifting has four groups of 64 rows.

    python benchmarks/step_costs.py
"""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from cells import opened
from one_step_losses import AlphaFlow

from cotlearn.couplings import Independent
from cotlearn.flows import FlowMatching, VelocityMLP
from cotlearn.flows.diffusion import regression_loss
from cotlearn.flows.networks import ResidualMLP
from cotlearn.flows.one_step import (
    Drifting,
    MeanFlow,
    MeanVelocity,
    Shortcut,
    TwoPasses,
)

BATCH, GROUP, ROUNDS = 256, 64, 40
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
    "drifting": (Drifting(), 1.0),
}


def step_of(loss: Any, network: Any, d: int, k: int) -> Callable[[], None]:
    """A function that does one step of a training."""
    g = torch.Generator().manual_seed(0)
    x0, x1, c = (torch.randn(BATCH, n, generator=g) for n in (d, d, k))
    pairs = replace(Independent()(x0, x1, c), group=torch.arange(BATCH) // GROUP)
    optimizer = torch.optim.Adam(network.parameters())

    def step() -> None:
        optimizer.zero_grad()
        loss(network, pairs, g).mean().backward()
        optimizer.step()

    return step


def measure(key: dict[str, Any]) -> list[dict[str, Any]]:
    """Milliseconds, the slower four fifths left out, and in units of flow matching."""
    d, k, make = NETWORKS[key["network"]]
    steps = {}
    for name, (loss, _) in LOSSES.items():
        jumps = isinstance(loss, AlphaFlow | MeanFlow | Shortcut)
        network = make(d, k + jumps)
        steps[name] = step_of(loss, MeanVelocity(network) if jumps else network, d, k)
    spent: dict[str, list[float]] = {name: [] for name in steps}
    for _ in range(ROUNDS):
        for name, step in steps.items():
            started = time.process_time()
            step()
            spent[name].append(1000 * (time.process_time() - started))
    found = {name: sorted(each)[ROUNDS // 5] for name, each in spent.items()}
    flow = found["flow matching"]
    return [
        {
            "loss": name,
            "milliseconds": round(found[name], 2),
            "counted": round(counted, 2),
            "measured": round(found[name] / flow, 2),
        }
        for name, (_, counted) in LOSSES.items()
    ]


def main() -> None:
    """Fill the table."""
    table = opened(__doc__ or "", {"batch": BATCH, "rounds": ROUNDS})
    table.fill([{"network": name} for name in NETWORKS], measure)


if __name__ == "__main__":
    main()
