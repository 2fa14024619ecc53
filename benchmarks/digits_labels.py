"""Do condition-blind optimal-transport pairs hurt on real images with labels?

Trains the same network on scikit-learn's digits with each coupling and several seeds, and scores
samples of each class against held-out images at several numbers of network evaluations (NFE).
The floor beside every score is what real training images get against the held-out ones.

    python benchmarks/digits_labels.py

writes data/results/digits_labels.json. Notebook 03 shows that table and repeats one row live.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import math
import os
import platform
import re
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.datasets import Dataset, digits
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import energy_distance, squared_w2
from cotlearn.storage import atomic_path

NFE = (1, 2, 4, 8, 16, 32, 64)
SETTINGS = {  # the first is what notebook 03 repeats live
    "short": {"width": 128, "steps": 2000, "batch_size": 256},
    "long": {"width": 256, "steps": 6000, "batch_size": 256},
}
DRAWS = 10  # sets of generated images that a score is averaged over
METRICS = {"energy_distance": energy_distance, "squared_w2": squared_w2}
ROOT = Path(__file__).resolve().parents[1]


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


def write(path: Path, document: dict[str, Any]) -> None:
    """Write JSON atomically, innermost lists of numbers on one line."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps(document, indent=1)
    text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    with atomic_path(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def main() -> None:
    """Run everything and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--long-seeds", type=int, default=3)
    parser.add_argument(
        "--output", type=Path, default=ROOT / "data" / "results" / "digits_labels.json"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)
    tables = {}
    for name, setting in SETTINGS.items():
        seeds = options.seeds if name == "short" else options.long_seeds
        rows = []
        for seed in range(seeds):
            for coupling in (Independent(), MinibatchOT(), ConditionalOT(math.inf)):
                rows.append(row(coupling, setting, seed))
                last = sum(rows[-1]["energy_distance"][-1]) / 10
                print(f"{name} seed {seed} {coupling.name}: {last:.3f} at NFE 64", flush=True)
        tables[name] = {"setting": setting, "rows": rows}
    train, held_out = digits("train"), digits("test")
    document = {
        "question": __doc__.splitlines()[0],
        "command": shlex.join(["python", "benchmarks/digits_labels.py", *sys.argv[1:]]),
        "seeds": {"short": options.seeds, "long": options.long_seeds},
        "nfe": NFE,
        "floor": score(train.sample_given, held_out, seed=0),
        "tables": tables,
        "versions": {
            "python": platform.python_version(),
            **{n: importlib.metadata.version(n) for n in ("torch", "numpy", "scipy", "POT")},
        },
        "machine": f"one of {os.cpu_count()} CPU cores of a shared server, {platform.machine()}",
        "cpu_seconds": round(time.process_time()),
    }
    write(options.output, document)


if __name__ == "__main__":
    main()
