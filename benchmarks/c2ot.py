"""How do couplings compare on C2OT's 8 Gaussians -> moons, with the class and with x as condition?

The task is that of Cheng & Schwing (2503.10636, Figure 1): the source is not normal noise but
eight Gaussians, the target two moons; the condition is the moon, or the first coordinate. The
score is the squared W2 between generated points, under conditions drawn from p(c), and as many
fresh points of the target, all conditions together; the floor is what fresh true points score.

    python benchmarks/c2ot.py             the reduced protocol, for everybody
    python benchmarks/c2ot.py --full      the published protocol: about a day

Reduced: 2,000 steps instead of 20,000, an OT batch of 512 instead of 1,024, 2,000 points instead
of 10,000, 3 seeds instead of 10, and the course's own optimiser settings, which fit a short run.
Stratified and semidiscrete pairs need finite data: 20,000 rows, drawn once; the others draw fresh
rows for ever. Model-aligned "full" has a batch of 64, its limit. Interrupted runs go on.

The published run has other moons and another network. Rows whose "data" or "network" is
"theirs" swap them in, one at a time and both; all else stays, the optimiser, too.
"""

import argparse
import functools
import math
from typing import Any

import torch
from cells import opened

from cotlearn.couplings import (
    AdaptiveConditionalOT,
    ConditionalOT,
    Coupling,
    Independent,
    MinibatchOT,
    ModelAligned,
    Reflow,
    SemidiscreteOT,
    StratifiedOT,
)
from cotlearn.datasets import Dataset, unconditional
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.flows.networks import seeded
from cotlearn.metrics import squared_w2
from cotlearn.mixtures import ConditionalGaussianMixture, eight_gaussians, moons

REDUCED = {
    "steps": 2000,
    "batch_size": 256,
    "ot_batch_size": 512,
    "width": 128,
    "depth": 3,
    "learning_rate": 2e-3,
    "schedule": "cosine",
    "ema": 0.99,
    "points": 2000,
    "seeds": 3,
    "rows": 20_000,
}
FULL = {
    **REDUCED,
    "steps": 20_000,
    "ot_batch_size": 1024,
    "learning_rate": 3e-4,
    "schedule": "constant",
    "ema": 0.0,
    "points": 10_000,
    "seeds": 10,
}
METHODS = {
    "class": [
        "minibatch_ot",
        "independent",
        "reflow",
        "conditional_ot_balanced",
        "conditional_ot_infinite",
        "stratified",
        "semidiscrete",
        "aligned_weighted",
        "aligned_topk",
        "aligned_full",
    ],
    "x": [
        "minibatch_ot",
        "independent",
        "reflow",
        "conditional_ot_balanced",
        "adaptive",
        "stratified",
        "semidiscrete",
        "aligned_weighted",
        "aligned_topk",
        "aligned_full",
    ],
}
NO_CELL = {
    "class": {
        "adaptive": "a target ratio of 0.05 cannot be met with two classes: r(infinity) is about "
        "1/4. C2OT itself uses an infinite weight for classes: conditional_ot_infinite"
    },
    "x": {"conditional_ot_infinite": "every x differs, so that this is independent coupling"},
}
PUBLISHED = {  # Cheng & Schwing 2503.10636, Figure 1: other budget, other hardware; context only
    "class": {
        "euler_1": {"independent": 2.573, "minibatch_ot": 0.483, "c2ot": 0.048},
        "adaptive_solver": {"independent": 0.059, "minibatch_ot": 0.462, "c2ot": 0.018},
    },
    "x": {
        "euler_1": {"independent": 0.732, "minibatch_ot": 8.276, "c2ot": 0.077},
        "adaptive_solver": {"independent": 0.028, "minibatch_ot": 2.143, "c2ot": 0.013},
        "standard_deviation": {"minibatch_ot": {"euler_1": 6.51, "adaptive_solver": 1.99}},
    },
}
THEIRS = {
    "data": "torchdyn's moons: evenly spaced angles, half of the rows on each moon, and one "
    "number, uniform in [0, 0.6], added to both coordinates. Ours: Gaussian noise of 0.6",
    "network": "linear layers of x, c and t are added up to 128 numbers h; three blocks then add "
    "W2 gelu(W1 h) of width 512 to h; nothing is normalised; 396,290 weights with x as condition. "
    "Ours: a perceptron of the width and depth above",
}
SWAPPED = [  # condition, methods, data, network, seeds
    ("x", ["minibatch_ot"], "theirs", "ours", 3),
    ("x", ["minibatch_ot"], "ours", "theirs", 3),
    ("x", ["floor", "minibatch_ot", "independent", "adaptive"], "theirs", "theirs", 3),
    (
        "class",
        ["floor", "minibatch_ot", "independent", "conditional_ot_infinite"],
        "theirs",
        "theirs",
        1,
    ),
]
CLUSTERS = {"class": 2, "x": 64}
TEACHER_NFE = 16
LAST = ("semidiscrete", "aligned")  # computed after all others, of all seeds
source_data = unconditional(eight_gaussians())


class PublishedNetwork(torch.nn.Module):
    """The network of the published run (see THEIRS), v(t, x, c) for x of two columns."""

    dim = 2

    def __init__(self, condition_dim: int, seed: int) -> None:
        super().__init__()
        self.condition_dim = condition_dim
        with seeded(seed):
            self.first = torch.nn.ModuleList(torch.nn.Linear(n, 128) for n in (2, condition_dim, 1))
            self.blocks = torch.nn.ModuleList(
                torch.nn.Sequential(
                    torch.nn.Linear(128, 512), torch.nn.GELU(), torch.nn.Linear(512, 128)
                )
                for _ in range(3)
            )
            self.last = torch.nn.Linear(128, 2)

    def forward(self, t: Any, x: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
        """The velocity, shape (B, 2)."""
        time = torch.as_tensor(t, dtype=x.dtype).expand(len(x))[:, None]
        inputs = (x, c, time)
        h = sum(layer(part) for layer, part in zip(self.first, inputs, strict=True))
        for block in self.blocks:
            h = h + block(h)
        return self.last(h)


def target(condition: str, data: str = "ours") -> ConditionalGaussianMixture:
    """The moons of a cell."""
    return moons(condition, torchdyn=data == "theirs")


def source(n: int, generator: torch.Generator | None = None) -> torch.Tensor:
    """Points of the eight Gaussians."""
    return source_data.sample(n, generator)[0]


@functools.cache
def finite(condition: str, rows: int) -> Dataset:
    """The training set of the couplings that look at all of it."""
    x1, c = moons(condition).sample(rows, generator=torch.Generator().manual_seed(12345))
    return Dataset(x1, c, name="moons")


@functools.cache
def semidiscrete(condition: str) -> SemidiscreteOT:
    """One potential for all seeds: the data set is the same."""
    weight = 0.0 if condition == "class" else 10.0  # inside a cluster c still varies with x
    return SemidiscreteOT(weight, clusters=CLUSTERS[condition])


@functools.cache
def trained(
    condition: str, method: str, seed: int, full: bool, data: str = "ours", network: str = "ours"
) -> torch.nn.Module:
    """The network of one cell; kept, because reflow learns from independent's."""
    setting: dict[str, Any] = dict(FULL if full else REDUCED)
    coupling = make(condition, method, seed, full)
    whole = method in ("stratified", "semidiscrete")
    rows = finite(condition, setting["rows"]) if whole else target(condition, data)
    batch = 64 if method == "aligned_full" else setting["batch_size"]
    pairs_at_once = batch if whole or coupling.traits.needs_network else setting["ot_batch_size"]
    sizes = {"width": setting["width"], "depth": setting["depth"]}
    start = (
        VelocityMLP(2, rows.condition_dim, **sizes, seed=seed)
        if network == "ours"
        else PublishedNetwork(rows.condition_dim, seed)
    )
    return fit(
        start,
        rows,
        coupling,
        steps=setting["steps"],
        batch_size=batch,
        ot_batch_size=pairs_at_once,
        source=source,
        seed=seed,
        learning_rate=setting["learning_rate"],
        schedule=setting["schedule"],
        ema=setting["ema"],
    ).network


def make(condition: str, method: str, seed: int, full: bool) -> Coupling:
    """The coupling of a cell."""
    half = (FULL if full else REDUCED)["steps"] // 2
    if method.startswith("aligned"):
        return ModelAligned(method.removeprefix("aligned_"), warmup_steps=half)
    if method == "reflow":
        teacher = trained(condition, "independent", seed, full)
        return Reflow(lambda x0, c: integrate(teacher, x0, c, nfe=TEACHER_NFE).x1)
    if method == "semidiscrete":
        return semidiscrete(condition)
    if method == "stratified":
        return StratifiedOT(CLUSTERS[condition])
    return {
        "independent": Independent(),
        "minibatch_ot": MinibatchOT(),
        "conditional_ot_balanced": ConditionalOT("balanced"),
        "conditional_ot_infinite": ConditionalOT(math.inf),
        "adaptive": AdaptiveConditionalOT(0.05),
    }[method]


def score(network: Any, data: ConditionalGaussianMixture, points: int, seed: int) -> dict[str, Any]:
    """Squared W2 on the marginal after one Euler step and with dopri5."""
    generator = torch.Generator().manual_seed(1000 + seed)
    truth, _ = data.sample(points, generator=generator)
    c = data.sample_conditions(points, generator=generator)
    x0 = source(points, generator=generator)
    one = integrate(network, x0, c, nfe=1).x1
    many = integrate(network, x0, c, method="dopri5")
    return {
        "euler_1": round(squared_w2(one, truth), 4),
        "dopri5": round(squared_w2(many.x1, truth), 4),
        "dopri5_nfe": many.nfe,
    }


def floor(data: ConditionalGaussianMixture, points: int, seed: int) -> dict[str, Any]:
    """What fresh true points score."""
    generator = torch.Generator().manual_seed(1000 + seed)
    first, second = (data.sample(points, generator=generator)[0] for _ in range(2))
    return {"squared_w2": round(squared_w2(first, second), 4)}


def compute(key: dict[str, Any], *, full: bool) -> dict[str, Any]:
    """One cell: train and score, or the floor."""
    condition, method, seed = key["condition"], key["method"], key["seed"]
    points = int((FULL if full else REDUCED)["points"])
    data = target(condition, key["data"])
    if method == "floor":
        return floor(data, points, seed)
    network = trained(condition, method, seed, full, key["data"], key["network"])
    values = score(network, data, points, seed)
    if method == "semidiscrete":
        fitted = semidiscrete(condition)
        values["marginal_error"] = round(fitted.marginal_error, 4)
        values["marginal_floor"] = round(fitted.marginal_floor, 4)
    return values


def main() -> None:
    """Fill the table and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true", help="the published protocol: about a day")
    options, _ = parser.parse_known_args()
    setting = FULL if options.full else REDUCED
    table = opened(
        __doc__,
        {
            **setting,
            "full": options.full,
            "aligned_full_batch_size": 64,
            "aligned_warmup_steps": setting["steps"] // 2,
            "clusters": CLUSTERS,
            "reflow_teacher": f"independent's network of the same seed, Euler, NFE {TEACHER_NFE}",
            "finite_training_set": ["stratified", "semidiscrete"],
            "no_cell": NO_CELL,
            "published": PUBLISHED,
            "theirs": THEIRS,
        },
        parser=parser,
        name="c2ot_full" if options.full else "c2ot",
    )
    ours = {"data": "ours", "network": "ours"}
    keys = [
        {"condition": condition, "method": method, "seed": seed, **ours}
        for last in (False, True)
        for seed in range(int(setting["seeds"]))
        for condition, methods in METHODS.items()
        for method in ["floor", *methods]
        if method.startswith(LAST) == last
    ]
    keys += [
        {"condition": condition, "method": method, "seed": seed, "data": data, "network": network}
        for condition, methods, data, network, seeds in SWAPPED
        for seed in range(seeds)
        for method in methods
    ]
    table.fill(keys, functools.partial(compute, full=options.full))
    same = ["condition", "method", *ours]
    print(table.frame().groupby(same)[["euler_1", "dopri5"]].mean().dropna().to_string())


if __name__ == "__main__":
    main()
