"""How near do optimal vector fields come to the optimal map, beside few-step flows?

Percent of unexplained variance, L2-UVP = 100 E|T(x0) - T*(x0)|^2 / Var(x1), on problems whose
optimal map T* from standard normal noise is known: random Gaussians, eight Gaussians, gradients of
random log-sum-exp potentials, and Gaussians that move and turn with a condition.

Every method has the batches of 256, networks of about the same number of parameters, one learning
rate for all problems (potentials 0.04, with a condition 0.005; velocities the course's 0.002) and a
cosine schedule. A step of a potential takes some four times as long as one of a velocity network,
so velocities make four times as many. All potentials start at the Gaussian map ("gaussian_start").

- ofm_*: optimal flow matching with independent, minibatch OT and anti (dearest instead of cheapest)
  pairs; with a condition, minibatch OT and anti are naive: they do not look at c.
- dual_*: its Hessian-free form, the maximum over x inside it found by Newton's method.
- mmv1: the same objective with 20 steps of Adam inside, from the standardised batch (after
  Taghvaei & Jalali 1902.07197, the name of Korotin et al. 2106.01954). With a condition that is too
  far away: 60 steps inside gave 0.15 % instead of 5.2 % (conditional_2, seed 0) in twice the time.
- cfm, ot_cfm, cot_cfm: flow matching with independent, minibatch OT, conditional OT pairs; values
  at 1 and 16 Euler steps. rectified: half of the steps cfm, half on pairs that it makes itself.

    python benchmarks/optimal_vector_fields.py

writes data/results/l2_uvp.csv. Its column `budget` is 1, or 5 and 10 for some methods with so many
times as many steps, where the short budget does not show what they can reach. An interrupted run
goes on.
"""

from typing import Any

import numpy as np
import torch
from cells import opened
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT, Pairs, Reflow
from cotlearn.couplings.base import Match
from cotlearn.couplings.distances import squared_distances
from cotlearn.datasets import unconditional
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.metrics import l2_uvp
from cotlearn.mixtures import eight_gaussians
from cotlearn.potentials import (
    ICNN,
    PICNN,
    ConditionalGaussian,
    KnownMap,
    LogSumExp,
    dual_loss,
    eight_gaussians_map,
    optimal_flow_matching_loss,
    transport,
)

SETTING = {
    "batch_size": 256,
    "seeds": 3,
    "points": 8000,
    "width": 64,
    "depth": 3,
    "width_of_velocities": 64,
    "width_of_velocities_with_condition": 128,
    "learning_rate_potentials": 4e-2,
    "learning_rate_potentials_with_condition": 5e-3,
    "learning_rate_velocities": 2e-3,
    "velocity_steps_per_potential_step": 4,
    "condition_weight": 1000,
    "steps_inside_mmv1": 20,
}
STEPS = {
    "gaussian_2": 150,
    "gaussian_8": 150,
    "gaussian_32": 150,
    "eight_gaussians": 800,
    "log_sum_exp_2": 300,
    "log_sum_exp_8": 300,
    "log_sum_exp_32": 200,
    "conditional_2": 250,
    "conditional_8": 250,
}
NFE = (1, 16)
UNCONDITIONAL = [
    "gaussian_start",
    "ofm_independent",
    "ofm_minibatch",
    "ofm_anti",
    "dual_independent",
    "mmv1",
    "cfm",
    "ot_cfm",
    "rectified",
]
CONDITIONAL = [
    "gaussian_start",
    "ofm_independent",
    "ofm_conditional",
    "ofm_minibatch",
    "ofm_anti",
    "dual_independent",
    "dual_minibatch",
    "mmv1",
    "cfm",
    "ot_cfm",
    "cot_cfm",
    "rectified",
]
LOG_SUM_EXP = ["log_sum_exp_2", "log_sum_exp_8", "log_sum_exp_32"]
#: How many times as many steps -> the problems, the methods.
BUDGETS: dict[int, tuple[list[str], list[str]]] = {
    5: (["eight_gaussians", *LOG_SUM_EXP], ["ofm_independent", "ot_cfm"]),
    10: (["eight_gaussians"], ["ofm_independent"]),
}


class Anti(MinibatchOT):
    """The dearest pairing of a batch instead of the cheapest."""

    name = "anti"

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Pair the batch by the negative cost."""
        return self.pair(-squared_distances(x0, x1), rng)


def coupling(method: str) -> Any:
    """The coupling of a method."""
    if method in ("cot_cfm", "ofm_conditional"):
        return ConditionalOT(SETTING["condition_weight"])
    if method.endswith("anti"):
        return Anti()
    return MinibatchOT() if method == "ot_cfm" or method.endswith("minibatch") else Independent()


def mmv1_loss(potential: Any, pairs: Pairs, generator: torch.Generator | None = None) -> Tensor:
    """The dual with an inner maximum that a few steps of Adam look for."""
    x0, x1 = pairs.x0, pairs.x1
    z = (x1 - x1.mean(dim=0)) / x1.std(dim=0)
    first, second = torch.zeros_like(z), torch.zeros_like(z)
    given = potential.given(pairs.c)
    with torch.no_grad():
        for step in range(1, SETTING["steps_inside_mmv1"] + 1):
            slope = given.gradient(z) - x1
            first, second = 0.9 * first + 0.1 * slope, 0.999 * second + 0.001 * slope.square()
            size = (second / (1 - 0.999**step)).sqrt() + 1e-8
            z = z - 0.1 * first / (1 - 0.9**step) / size
    conjugate = (x1 * z).sum(dim=1) - given.value(z)
    return 2 * (given.value(x0) + conjugate - (x0 * x1).sum(dim=1))


def problem(name: str, seed: int) -> tuple[Any, Tensor, Tensor | None, Tensor, float]:
    """Data, test noise, test conditions, the true map of it, and the variance."""
    generator = torch.Generator().manual_seed(1000 + seed)
    kind, _, dim = name.rpartition("_")
    if name == "eight_gaussians":
        x0, truth = eight_gaussians_map(1024, seed=2 * seed)
        return unconditional(eight_gaussians()), x0, None, truth, float(truth.var(dim=0).sum())
    d = int(dim)
    x0 = torch.randn(SETTING["points"], d, generator=generator)
    if kind == "conditional":
        data = ConditionalGaussian(d)
        c = data.sample_conditions(len(x0), generator)
        return data, x0, c, data.transport(x0, c), data.variance()
    known = KnownMap.gaussian(d, seed=seed)
    if kind == "log_sum_exp":
        known = KnownMap(LogSumExp(d, seed=seed).gradient, d)
    truth = known.transport(x0)
    return known, x0, None, truth, float(truth.var(dim=0).sum())


def train(network: Any, data: Any, pairs: Any, key: dict[str, Any], **options: Any) -> Any:
    """The trained network."""
    return fit(
        network,
        data,
        pairs,
        batch_size=SETTING["batch_size"],
        seed=key["seed"],
        progress=False,
        **options,
    ).network


def of_potential(key: dict[str, Any]) -> dict[str, Any]:
    """Train a potential; its map is one gradient."""
    data, x0, c, truth, variance = problem(key["problem"], key["seed"])
    d = x0.shape[1]
    some = data.sample(4096, generator=torch.Generator().manual_seed(2000 + key["seed"]))
    shape = {"width": SETTING["width"], "depth": SETTING["depth"], "seed": key["seed"]}
    start = ICNN(d, **shape) if c is None else PICNN(d, 1, **shape)
    start.start_at_gaussian(*some)
    method = key["method"]
    trained: Any = start
    if method != "gaussian_start":
        losses = {"ofm": optimal_flow_matching_loss, "dual": dual_loss, "mmv1": mmv1_loss}
        rate = "learning_rate_potentials" + ("" if c is None else "_with_condition")
        trained = train(
            start,
            data,
            coupling(method),
            key,
            steps=key["budget"] * STEPS[key["problem"]],
            loss=losses[method.split("_")[0]],
            learning_rate=SETTING[rate],
        )
    uvp = l2_uvp(transport(trained, x0, c), truth, variance=variance)
    return {"l2_uvp": {1: round(uvp, 4)}, "parameters": sum(p.numel() for p in start.parameters())}


def of_velocity(key: dict[str, Any]) -> dict[str, Any]:
    """Train a velocity; its map at 1 and 16 Euler steps."""
    data, x0, c, truth, variance = problem(key["problem"], key["seed"])
    k = 0 if c is None else 1
    width = SETTING["width_of_velocities" + ("_with_condition" if k else "")]
    network = VelocityMLP(x0.shape[1], k, width=width, depth=SETTING["depth"], seed=key["seed"])
    steps = key["budget"] * STEPS[key["problem"]] * SETTING["velocity_steps_per_potential_step"]
    options = {"steps": steps, "learning_rate": SETTING["learning_rate_velocities"]}
    if key["method"] == "rectified":
        options["steps"] = steps // 2
        first = train(network, data, Independent(), key, **options)

        def made(noise: Tensor, c: Tensor | None) -> Tensor:
            return integrate(first, noise, c, nfe=16).x1

        network = train(first, data, Reflow(made), key, **options)
    else:
        network = train(network, data, coupling(key["method"]), key, **options)
    made = {nfe: integrate(network, x0, c, nfe=nfe).x1 for nfe in NFE}
    return {
        "l2_uvp": {n: round(l2_uvp(x, truth, variance=variance), 4) for n, x in made.items()},
        "parameters": sum(p.numel() for p in network.parameters()),
    }


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One cell."""
    flows = ("cfm", "ot_cfm", "cot_cfm", "rectified")
    return of_velocity(key) if key["method"] in flows else of_potential(key)


def main() -> None:
    """Fill the table and print it."""
    cases = [
        (1, name, method)
        for name in STEPS
        for method in (CONDITIONAL if name.startswith("conditional") else UNCONDITIONAL)
    ]
    for budget, (problems, methods) in BUDGETS.items():
        cases += [(budget, name, method) for name in problems for method in methods]
    protocol = {**SETTING, "steps": STEPS, "nfe": NFE}
    table = opened(__doc__, protocol, name="l2_uvp", axis="nfe")
    keys = [
        {"problem": name, "method": method, "budget": budget, "seed": seed}
        for seed in range(SETTING["seeds"])
        for budget, name, method in cases
    ]
    table.fill(keys, compute)
    rows = table.frame().groupby(["problem", "budget", "method", "nfe"])
    print(rows[["l2_uvp", "cpu_seconds"]].mean().to_string())


if __name__ == "__main__":
    main()
