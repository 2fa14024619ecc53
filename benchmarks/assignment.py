"""How fast is exact minibatch pairing, side by side with others in one run?

Every method is given the same batch and returns paired rows: cost matrix, solver and look-up are
inside the time. Methods take turns, so that a machine that drifts drifts for all of them; the
medians are reported. `torchcfm` is what its users call, `OTPlanSampler("exact").sample_plan`, and
draws with replacement; `scipy` and `pot` are the plainest code with `linear_sum_assignment` and
`ot.emd`.

Needs `pip install torchcfm` (with --no-deps it installs nothing else).

    python benchmarks/assignment.py
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import ot
import torch
from cells import opened
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from torch import Tensor

from cotlearn.couplings import ConditionalOT, MinibatchOT

WEIGHT = 30.0  # of the condition, in the condition-augmented problems
ROUNDS = {128: 15, 256: 11, 512: 7, 1024: 5, 2048: 2}
Batch = tuple[Tensor, Tensor, Tensor]


def batch(rows: int, dim: int, target: str, seed: int) -> Batch:
    """Standard normal noise, data (a broad Gaussian or eight clusters) and conditions in 1D."""
    g = torch.Generator().manual_seed(seed)
    x0, x1 = torch.randn(2, rows, dim, generator=g)
    c = torch.randn(rows, 1, generator=g)
    if target == "clusters":
        centres = 2 * torch.randn(8, dim, generator=g)
        return x0, 0.3 * x1 + centres[torch.randint(8, (rows,), generator=g)], c
    return x0, 0.5 * x1 + 1, c


def augmented(x0: Tensor, x1: Tensor, c: Tensor, weight: float) -> tuple[Tensor, Tensor]:
    """Noise and data with sqrt(w) c appended: their squared distance is the conditional cost."""
    if weight == 0:
        return x0, x1
    c0 = c[torch.randperm(len(c), generator=torch.Generator().manual_seed(0))]
    return torch.cat([x0, weight**0.5 * c0], 1), torch.cat([x1, weight**0.5 * c], 1)


def methods(weight: float) -> dict[str, Callable[[Batch], Any]]:
    """Each method: a batch in, paired rows out."""
    from torchcfm.optimal_transport import OTPlanSampler

    own = ConditionalOT(weight) if weight else MinibatchOT()
    plan_sampler = OTPlanSampler("exact")

    def scipy(b: Batch) -> Any:
        a0, a1 = augmented(*b, weight)
        _, columns = linear_sum_assignment(cdist(a0.numpy(), a1.numpy(), "sqeuclidean"))
        return b[0], b[1][columns], b[2][columns]

    def pot(b: Batch) -> Any:
        a0, a1 = augmented(*b, weight)
        uniform = np.full(len(a0), 1 / len(a0))
        cost = cdist(a0.numpy(), a1.numpy(), "sqeuclidean")
        columns = ot.emd(uniform, uniform, cost, numItermax=10_000_000).argmax(axis=1)
        return b[0], b[1][columns], b[2][columns]

    def torchcfm(b: Batch) -> Any:
        return plan_sampler.sample_plan(*augmented(*b, weight))

    return {"cotlearn": lambda b: own(*b), "torchcfm": torchcfm, "scipy": scipy, "pot": pot}


def optimal_costs(b: Batch, weight: float) -> tuple[float, float]:
    """The mean cost by our solver and by SciPy, for one and the same problem."""
    from cotlearn.couplings.assignment import exact_permutation

    a0, a1 = augmented(*b, weight)
    cost = cdist(a0.numpy(), a1.numpy(), "sqeuclidean")
    rows = np.arange(len(cost))
    ours = cost[rows, exact_permutation(cost)].mean()
    return float(ours), float(cost[rows, linear_sum_assignment(cost)[1]].mean())


def measure(key: dict[str, Any]) -> dict[str, Any]:
    """Median milliseconds of every method at one size."""
    rounds = ROUNDS[key["rows"]]
    candidates = methods(key["weight"])
    times: dict[str, list[float]] = {name: [] for name in candidates}
    for seed in range(rounds + 1):
        b = batch(key["rows"], key["dim"], key["target"], seed)
        for name, method in candidates.items():
            started = time.perf_counter()
            method(b)
            if seed:  # the first round warms up
                times[name].append(1000 * (time.perf_counter() - started))
    ours, scipy = optimal_costs(batch(key["rows"], key["dim"], key["target"], 0), key["weight"])
    return {
        "milliseconds": {n: round(statistics.median(v), 3) for n, v in times.items()},
        "relative_cost_difference": abs(ours - scipy) / scipy,
    }


def main() -> None:
    """Fill the table; print torchcfm's time over ours, and our worst ratio to the fastest other."""
    table = opened(
        "How fast is exact minibatch pairing beside torchcfm, SciPy and POT?",
        {"condition_weight": WEIGHT, "rounds": {str(k): v for k, v in ROUNDS.items()}},
    )
    keys = [
        {"rows": rows, "dim": dim, "target": target, "weight": weight}
        for rows in ROUNDS
        for dim in (2, 16, 64)
        for target in ("gaussian", "clusters")
        for weight in (0.0, WEIGHT)
    ]
    table.fill(keys, measure)
    ms = table.frame().filter(like="milliseconds_")
    ours = ms.pop("milliseconds_cotlearn")
    print(f"torchcfm / ours: {statistics.geometric_mean(ms['milliseconds_torchcfm'] / ours):.2f}")
    print(f"ours / fastest other, at most: {(ours / ms.min(axis=1)).max():.2f}")


if __name__ == "__main__":
    main()
