"""Do condition-blind optimal-transport pairs hurt on real images with labels?

Trains the same network on scikit-learn's digits with each coupling and several seeds, and scores
samples of each class against held-out images at several numbers of network evaluations (NFE).
The floor beside every score is what real training images get against the held-out ones.

    python benchmarks/digits_labels.py

writes data/results/digits_labels.json row by row; a run that was stopped goes on where it was, and
rows that are stored are kept. Notebook 03 shows that table, laboratory 03 repeats two rows live,
laboratory 04 another.
"""

import argparse
import itertools
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from cells import COMMAND, RESULTS

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.datasets import Dataset, digits
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import energy_distance, squared_w2
from cotlearn.results import machine, read_json, write_json

NFE = (1, 2, 4, 8, 16, 32, 64)
SETTINGS = {  # the first is what laboratory 03 repeats live
    "short": {"width": 128, "steps": 2000, "batch_size": 256},
    "long": {"width": 256, "steps": 6000, "batch_size": 256},
}
DRAWS = 10  # sets of generated images that a score is averaged over
METRICS = {"energy_distance": energy_distance, "squared_w2": squared_w2}
COUPLINGS: dict[str, Callable[[], Coupling]] = {
    "independent": Independent,
    "minibatch_ot": MinibatchOT,
    "conditional_ot": lambda: ConditionalOT(math.inf),
    "stratified": StratifiedOT,  # one stratum a label
}


def score(sample: Callable[..., torch.Tensor], held_out: Dataset, seed: int) -> dict[str, Any]:
    """Each metric for each class: as many samples as held-out images, averaged over draws."""
    generator = torch.Generator().manual_seed(seed)
    values: dict[str, list[float]] = {name: [] for name in METRICS}
    for label in torch.eye(held_out.condition_dim):
        real = held_out.x1[(held_out.c == label).all(dim=1)]
        condition = label.expand(len(real), -1)
        draws = [sample(condition, generator=generator) for _ in range(DRAWS)]
        for name, metric in METRICS.items():
            mean = sum(metric(draw, real) for draw in draws) / DRAWS
            values[name].append(round(mean, 5))
    return values


def row(coupling: Any, setting: dict[str, int], seed: int) -> dict[str, Any]:
    """Train one network and score it at every NFE."""
    train, held_out = digits("train"), digits("test")
    started = time.process_time()
    start = VelocityMLP(64, 10, width=setting["width"], seed=seed)
    result = fit(
        start,
        train,
        coupling,
        steps=setting["steps"],
        batch_size=setting["batch_size"],
        seed=seed,
    )
    trained = time.process_time()
    scores = [score(sampler(result.network, nfe=nfe), held_out, seed=seed) for nfe in NFE]
    return {
        "coupling": coupling.name,
        "seed": seed,
        "training_cpu_seconds": round(trained - started, 1),
        **{name: [s[name] for s in scores] for name in METRICS},  # (NFE, class)
    }


def kept(stored: dict[str, Any], name: str, setting: dict[str, int]) -> list[dict[str, Any]]:
    """The rows of a stored table, if they were made with these settings."""
    table = stored.get("tables", {}).get(name)
    if table is None:
        return []
    if table["setting"] != setting or stored["nfe"] != list(NFE):
        raise ValueError("the stored table was made with other settings: use --output")
    return list(table["rows"])


def main() -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--long-seeds", type=int, default=3)
    parser.add_argument("--output", type=Path, default=RESULTS / "digits_labels.json")
    options = parser.parse_args()
    torch.set_num_threads(1)
    train, held_out = digits("train"), digits("test")
    stored = read_json(options.output) if options.output.exists() else {}
    document: dict[str, Any] = {
        "question": __doc__.splitlines()[0],
        "command": COMMAND,
        "seeds": {"short": options.seeds, "long": options.long_seeds},
        "nfe": NFE,
        "floor": stored.get("floor") or score(train.sample_given, held_out, seed=0),
        "tables": {
            name: {"setting": setting, "rows": kept(stored, name, setting)}
            for name, setting in SETTINGS.items()
        },
        **machine("POT"),
    }
    before = stored.get("cpu_seconds", 0)
    for name, setting in SETTINGS.items():
        rows = document["tables"][name]["rows"]
        for seed, coupling in itertools.product(range(document["seeds"][name]), COUPLINGS):
            if any((r["coupling"], r["seed"]) == (coupling, seed) for r in rows):
                continue
            rows.append(row(COUPLINGS[coupling](), setting, seed))
            last = sum(rows[-1]["energy_distance"][-1]) / 10
            print(f"{name} seed {seed} {coupling}: {last:.3f} at NFE 64", flush=True)
            document["cpu_seconds"] = before + round(time.process_time())
            write_json(options.output, document)


if __name__ == "__main__":
    main()
