"""Moons with labels and a fork with a continuous condition: how good are one and two evaluations?

The two toys of COT Policy (2505.01179), from normal noise: `moons("class")` and `fork()`. Its own
definitions of the two shapes are not public to the last digit; these are the course's. Two scores,
each with its floor: squared W2 with all conditions together ("marginal", as published), and squared
W2 for each condition, averaged ("conditional", which sees it when conditions are mixed up).

    python benchmarks/cot_policy_toys.py

writes data/results/cot_policy_toys.csv. NFE 2 is measured twice: two Euler steps, and one midpoint
step. An interrupted run goes on.
"""

from functools import partial
from typing import Any

import torch
from cells import opened
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, KMeansCondition, MinibatchOT
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.metrics import conditional_squared_w2, squared_w2
from cotlearn.mixtures import fork, moons

SETTING = {"steps": 2000, "batch_size": 256, "width": 128, "depth": 3, "seeds": 3, "points": 2000}
SMALL = 64  # COT Policy's own batch, with as many clusters
SOLVERS: dict[str, dict[str, Any]] = {
    "euler_1": {"nfe": 1},
    "euler_2": {"nfe": 2},
    "midpoint_2": {"nfe": 2, "method": "midpoint"},
}
TOYS = {"moons": moons("class"), "fork": fork()}
METHODS = {
    "moons": ["minibatch_ot", "independent", "conditional_ot"],
    "fork": [
        "minibatch_ot",
        "independent",
        "conditional_ot",
        "conditional_ot_64_clusters",
        "conditional_ot_64_clusters_batch_64",
    ],
}
PUBLISHED = {  # COT Policy 2505.01179, squared W2; context only
    "moons": {"nfe_1": {"independent": 1.490, "minibatch_ot": 0.777, "conditional_ot": 0.345}},
    "fork": {
        "nfe_1": {"independent": 1.134, "minibatch_ot": 2.678, "conditional_ot": 0.349},
        "nfe_2": {"independent": 0.575, "minibatch_ot": 0.992, "conditional_ot": 0.125},
    },
}


def make(method: str, toy: str) -> Coupling:
    """The coupling of a cell; the weight is always the paper's rule."""
    if method == "independent":
        return Independent()
    if method == "minibatch_ot":
        return MinibatchOT()
    if method == "conditional_ot":
        return ConditionalOT("balanced")
    clusters = KMeansCondition(SMALL)
    c = TOYS[toy].sample_conditions(10_000, generator=torch.Generator().manual_seed(0))
    return ConditionalOT("balanced", condition=clusters.fit(c))


def scores(sample: Any, toy: str, seed: int) -> dict[str, float]:
    """Squared W2 on the marginal and for each condition."""
    data, points = TOYS[toy], SETTING["points"]
    generator = torch.Generator().manual_seed(1000 + seed)
    truth, _ = data.sample(points, generator=generator)
    c = data.sample_conditions(points, generator=generator)
    marginal = squared_w2(sample(c, generator=generator), truth)
    conditional = conditional_squared_w2(sample, data, n=500, generator=generator)
    return {"marginal": round(marginal, 4), "conditional": round(conditional, 4)}


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One cell: train and score, or the floor."""
    toy, method, seed = key["toy"], key["method"], key["seed"]
    data = TOYS[toy]
    if method == "floor":
        return {"floor": scores(data.sample_given, toy, seed)}
    start = VelocityMLP(2, data.condition_dim, width=SETTING["width"], seed=seed)
    batch = SMALL if method.endswith("batch_64") else SETTING["batch_size"]
    coupling = make(method, toy)
    network = fit(
        start, data, coupling, steps=SETTING["steps"], batch_size=batch, seed=seed
    ).network

    def drawn(c: Tensor, generator: torch.Generator, **solver: Any) -> Tensor:
        return integrate(network, torch.randn(len(c), 2, generator=generator), c, **solver).x1

    values = {n: scores(partial(drawn, **s), toy, seed) for n, s in SOLVERS.items()}
    x1, c = data.sample(batch, generator=torch.Generator().manual_seed(seed))
    x0 = torch.randn(batch, 2, generator=torch.Generator().manual_seed(seed + 1))
    return {**values, "candidates": round(coupling.candidates(x0, x1, c), 2)}


def main() -> None:
    """Fill the table and print it."""
    table = opened(__doc__, {**SETTING, "small_batch": SMALL, "published": PUBLISHED})
    keys = [
        {"toy": toy, "method": method, "seed": seed}
        for seed in range(SETTING["seeds"])
        for toy, methods in METHODS.items()
        for method in ["floor", *methods]
    ]
    table.fill(keys, compute)
    print(table.frame().groupby(["toy", "method"]).mean().T.to_string())


if __name__ == "__main__":
    main()
