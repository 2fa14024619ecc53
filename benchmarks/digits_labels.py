"""Do condition-blind optimal-transport pairs hurt on real images with labels?

Trains the same network on scikit-learn's digits with each coupling and several seeds, and scores
samples of each class against held-out images at several numbers of network evaluations (NFE).
The floor beside every score is what real training images get against the held-out ones.

    python benchmarks/digits_labels.py

writes data/results/digits_labels.csv. An interrupted run goes on. Notebook 03 shows that table,
laboratory 03 repeats two rows live, laboratory 04 another.
"""

import math
import time
from collections.abc import Callable
from typing import Any

import torch
from cells import opened

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.datasets import Dataset, digits
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import energy_distance, squared_w2

NFE = (1, 2, 4, 8, 16, 32, 64)
SETTINGS = {  # the first is what laboratory 03 repeats live
    "short": {"width": 128, "steps": 2000, "batch_size": 256},
    "long": {"width": 256, "steps": 6000, "batch_size": 256},
}
SEEDS = {"short": 5, "long": 3}
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


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """The floor of training images, or one network trained and scored at every NFE."""
    train, held_out = digits("train"), digits("test")
    seed, labels = key["seed"], range(10)
    if key["coupling"] == "floor":
        floor = score(train.sample_given, held_out, seed)
        return {metric: dict(enumerate(values)) for metric, values in floor.items()}
    setting, started = SETTINGS[key["training"]], time.process_time()
    trained = fit(
        VelocityMLP(64, 10, width=setting["width"], seed=seed),
        train,
        COUPLINGS[key["coupling"]](),
        steps=setting["steps"],
        batch_size=setting["batch_size"],
        seed=seed,
    )
    spent = time.process_time() - started
    found = {nfe: score(sampler(trained.network, nfe=nfe), held_out, seed) for nfe in NFE}
    return {
        metric: {label: {nfe: found[nfe][metric][label] for nfe in NFE} for label in labels}
        for metric in METRICS
    } | {"training_cpu_seconds": round(spent, 1)}


def main() -> None:
    """Fill the table."""
    protocol = {"settings": SETTINGS, "seeds": SEEDS, "nfe": NFE, "draws": DRAWS}
    table = opened(__doc__, protocol, axis="label nfe")
    keys = [
        {"training": training, "coupling": coupling, "seed": seed}
        for training, seeds in SEEDS.items()
        for seed in range(seeds)
        for coupling in COUPLINGS
    ]
    table.fill([{"training": "none", "coupling": "floor", "seed": 0}, *keys], compute)


if __name__ == "__main__":
    main()
