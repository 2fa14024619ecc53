"""What should the network predict: noise, data or velocity, on which path, with which pairs?

A factorial in 2D, where the floor is known: flows on the straight path and diffusion models on the
variance-preserving one (DDIM, trailing), every target that can be sampled in one step and the
noise beside them, with independent, naive and conditional pairs. Same network, batches, steps and
seeds. The score is squared W2 for each condition, averaged; also with less noise at the start.

    python benchmarks/prediction_target.py

writes data/results/prediction_target.csv. An interrupted run goes on.
"""

import math
from functools import partial
from itertools import product
from typing import Any

import torch
from cells import opened, score
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.flows import FlowMatching, VelocityMLP, fit, integrate, velocity_of
from cotlearn.flows.diffusion import Diffusion
from cotlearn.mixtures import petals, rotating_pair

SETTING = {"steps": 2000, "batch_size": 256, "ot_batch_size": 256, "width": 128, "depth": 3}
SEEDS, EVALUATIONS, TEMPERATURES = range(3), (1, 2, 4, 16), (1.0, 0.8, 0.6)
DATA: dict[str, Any] = {"petals": petals(), "rotating_pair": rotating_pair()}
ROWS = 8192  #: of `rotating_pair`, for strata
MODELS = (
    ("straight", "velocity"),
    ("straight", "data"),
    ("variance preserving", "noise"),
    ("variance preserving", "velocity"),
    ("variance preserving", "data"),
)


def pairs(name: str, data: str) -> Coupling:
    """The coupling of a cell; the conditional one is exact for labels, in strata for a number."""
    conditional = ConditionalOT(math.inf) if data == "petals" else StratifiedOT(128)
    made = {"independent": Independent(), "naive": MinibatchOT(), "conditional": conditional}
    return made[name]


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One cell: the floor, or a training and its scores."""
    data, seed = DATA[key["data"]], key["seed"]
    if key["path"] == "floor":
        return {"floor": score(data.sample_given, data, seed)}
    flow = key["path"] == "straight"
    rows = Dataset(*data.sample(ROWS, generator=torch.Generator().manual_seed(seed)))
    diffusion = Diffusion(
        100,
        clip=float(rows.x1.abs().max()),
        prediction=key["target"],
        zero_terminal_snr=key["target"] != "noise",
    )
    sizes = {name: SETTING[name] for name in ("width", "depth")}
    trained = fit(
        VelocityMLP(rows.dim, rows.condition_dim, seed=seed, **sizes),
        rows if key["data"] == "rotating_pair" else data,
        pairs(key["pairs"], key["data"]),
        steps=SETTING["steps"],
        batch_size=SETTING["batch_size"],
        ot_batch_size=SETTING["ot_batch_size"],
        loss=FlowMatching(prediction=key["target"]) if flow else diffusion.loss,
        seed=seed,
        progress=False,
    ).network

    def draw(nfe: int, temperature: float, c: Tensor, generator: torch.Generator) -> Tensor:
        x0 = temperature * torch.randn(len(c), 2, generator=generator)
        if flow:
            return integrate(velocity_of(trained, key["target"]), x0, c, nfe=nfe).x1
        return diffusion.ddim(trained, x0, c, nfe=nfe, spacing="trailing")

    return {
        "squared_w2": {
            temperature: {n: score(partial(draw, n, temperature), data, seed) for n in EVALUATIONS}
            for temperature in TEMPERATURES
        }
    }


def main() -> None:
    """Fills the table."""
    protocol = {**SETTING, "rows_of_rotating_pair": ROWS}
    table = opened(__doc__ or "", protocol, axis="temperature nfe")
    keys = [
        {"data": data, "path": path, "target": target, "pairs": name, "seed": seed}
        for seed, data, (path, target), name in product(
            SEEDS, DATA, MODELS, ("independent", "naive", "conditional")
        )
    ]
    floors = [
        {"data": data, "path": "floor", "target": "", "pairs": "", "seed": seed}
        for data, seed in product(DATA, SEEDS)
    ]
    table.fill(floors + keys, compute)


if __name__ == "__main__":
    main()
