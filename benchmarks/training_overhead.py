"""How much longer does training take with a conditional coupling than with the independent one?

The same residual network of a million parameters, the same steps of 256 rows; pairs are prepared
in the background while the network trains, if torch leaves a core free (`cotlearn.flows.prefetch`):
here with one thread of two. The last column makes the same pairs between the steps. Rounds take
turns; the medians are reported.

    python benchmarks/training_overhead.py
"""

import statistics
from collections.abc import Callable
from typing import Any
from unittest import mock

import torch
from cells import opened

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.flows import fit
from cotlearn.flows.networks import ResidualMLP

ROWS, DIM, CONDITION_DIM = 50_000, 32, 10
STEPS, BATCH, ROUNDS = 120, 256, 3
COUPLINGS: dict[str, Callable[[], Coupling]] = {
    "independent": Independent,
    "minibatch_ot": MinibatchOT,
    "conditional_ot": ConditionalOT,
    "stratified": lambda: StratifiedOT(256),
}


def actions() -> Dataset:
    """Smooth conditions and chunks of actions that follow them."""
    g = torch.Generator().manual_seed(0)
    c = torch.randn(ROWS, CONDITION_DIM, generator=g)
    noise = torch.randn(ROWS, DIM, generator=g)
    return Dataset(c @ torch.randn(CONDITION_DIM, DIM, generator=g) + 0.5 * noise, c)


def seconds(coupling: Coupling, network: torch.nn.Module, data: Dataset, ot_batch: int) -> float:
    """Seconds of a step, fits of the coupling and the first steps left out."""
    ot_batch_size = None if isinstance(coupling, StratifiedOT) else ot_batch
    result = fit(
        network, data, coupling, steps=STEPS, batch_size=BATCH, ot_batch_size=ot_batch_size,
        log_every=STEPS // 3, progress=False,
    )  # fmt: skip
    spent = result.history["seconds"]
    return float(spent[-1] - spent[0]) / (STEPS - STEPS // 3)


def measure(key: dict[str, Any]) -> list[dict[str, Any]]:
    """Median milliseconds of a step, for each coupling, and the ratios to independent."""
    torch.set_num_threads(key["threads"])
    data = actions()
    network = ResidualMLP(DIM, CONDITION_DIM, width=336, seed=0)
    times: dict[str, list[float]] = {
        name: [] for name in [*COUPLINGS, "conditional_ot, pairs between the steps"]
    }
    for _ in range(ROUNDS):
        for name, make in COUPLINGS.items():
            times[name].append(1000 * seconds(make(), network, data, key["ot_batch"]))
        with mock.patch("cotlearn.flows.training.prefetch", iter):
            alone = seconds(ConditionalOT(), network, data, key["ot_batch"])
        times["conditional_ot, pairs between the steps"].append(1000 * alone)
    medians = {name: statistics.median(values) for name, values in times.items()}
    return [
        {
            "coupling": name,
            "milliseconds_per_step": round(median, 2),
            "ratio_to_independent": round(median / medians["independent"], 3),
            "parameters": sum(p.numel() for p in network.parameters()),
        }
        for name, median in medians.items()
    ]


def main() -> None:
    """Fill the table."""
    table = opened(
        "How much longer does training take with a conditional coupling?",
        {
            "rows": ROWS, "dim": DIM, "condition_dim": CONDITION_DIM, "steps": STEPS,
            "batch": BATCH, "rounds": ROUNDS,
        },
    )  # fmt: skip
    keys = [{"ot_batch": n, "threads": t} for n in (256, 512) for t in (1, 2)]
    table.fill(keys, measure)


if __name__ == "__main__":
    main()
