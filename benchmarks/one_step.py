"""Which way to few evaluations is best under a condition, at equal cost?

Losses, each on independent pairs and, where it uses the noise, on conditional pairs: flow
matching, regression, two passes, mean flow (and without its instants), shortcut, drifting, a
learned source, reflow on the pairs of a teacher, and reflow on real data with the noise that the
teacher's inverse gives. Every training costs as much as STEPS of flow matching, counted in
forward-equivalents (a backward pass is two); reflow spends half of that on its teacher. The score
is squared W2 for each condition, averaged.

    python benchmarks/one_step.py

writes data/results/one_step.json. An interrupted run goes on.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import torch
from cells import opened, score
from torch import Tensor, nn

from cotlearn.couplings import ConditionalOT, Coupling, FixedPairs, Independent, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.flows import FlowMatching, VelocityMLP, fit, integrate
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.matching import Loss
from cotlearn.flows.one_step import (
    Drifting,
    LearnedSource,
    MeanFlow,
    MeanVelocity,
    Shortcut,
    TwoPasses,
    jump,
    learned_source_loss,
)
from cotlearn.mixtures import moving_modes, petals, rotating_pair

STEPS, ROWS, TEACHER_NFE, DRAWS = 4000, 8192, 16, 4
SIZES: dict[str, Any] = {"width": 128, "depth": 3}
BATCH = {"batch_size": 256, "ot_batch_size": 256}
SEEDS, EVALUATIONS = range(5), (1, 2, 4)
DATA: dict[str, Any] = {
    "petals": petals(),
    "moving_modes": moving_modes(),
    "rotating_pair": rotating_pair(),
}
Draw = Callable[[Any, Tensor, Tensor, int], Tensor]


def euler(network: Any, x0: Tensor, c: Tensor, nfe: int) -> Tensor:
    """Samples by Euler's method, from the source of the network if it has its own."""
    start = network.source(x0, c) if isinstance(network, LearnedSource) else x0
    return integrate(network, start, c, nfe=nfe).x1


def by_jumps(network: Any, x0: Tensor, c: Tensor, nfe: int) -> Tensor:
    """Samples by equal jumps."""
    return jump(network, x0, c, nfe=nfe)


@torch.no_grad()
def at_once(network: Any, x0: Tensor, c: Tensor, nfe: int) -> Tensor:
    """Samples by one evaluation at t = 0."""
    return network(x0.new_zeros(()), x0, c)


@dataclass(frozen=True)
class Way:
    """A row: a loss, its cost for a row in units of flow matching, its network and sampler."""

    loss: Loss
    cost: float = 1.0
    network: Callable[[nn.Module], nn.Module] = lambda plain: plain
    draw: Draw = euler
    evaluations: tuple[int, ...] = EVALUATIONS
    columns: int = 0  #: of the condition, added
    pairs: tuple[str, ...] = ("independent", "conditional")


WAYS = {
    "flow matching": Way(FlowMatching()),
    "flow matching, t = 0": Way(FlowMatching(share_at_t0=0.3)),
    "regression": Way(
        regression_loss,
        draw=lambda network, x0, c, nfe: predict(network, x0, c).detach(),
        evaluations=(1,),
        pairs=("independent",),
    ),
    "two passes": Way(
        TwoPasses(),
        cost=2,
        draw=lambda network, x0, c, nfe: TwoPasses().sample(network, x0, c),
        evaluations=(2,),
        pairs=("independent",),
    ),
    "mean flow": Way(MeanFlow(), 4 / 3, MeanVelocity, by_jumps, columns=1),
    "mean flow, no instants": Way(
        MeanFlow(share_instant=0.0), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "shortcut": Way(Shortcut(share=0.25), 1 + 0.25 * 2 / 3, MeanVelocity, by_jumps, columns=1),
    "drifting": Way(Drifting(DRAWS), cost=DRAWS, draw=at_once, evaluations=(1,)),
    "learned source": Way(learned_source_loss, 1.1, lambda plain: LearnedSource(plain, seed=0)),
    "reflow": Way(FlowMatching(), pairs=("teacher",)),
    "reflow on real data": Way(FlowMatching(), pairs=("teacher, inverted",)),
}


def coupling_of(name: str, data: str) -> Coupling:
    """Independent pairs, or conditional ones: exact for labels, in strata for a number."""
    if name == "conditional":
        return ConditionalOT(math.inf) if data == "petals" else StratifiedOT(128)
    return Independent()


def trained_flow(data: Any, steps: int, coupling: Coupling, seed: int, start: Any = None) -> Any:
    """A flow with a share of its rows at t = 0."""
    network = start or VelocityMLP(2, data.condition_dim, seed=seed, **SIZES)
    loss = FlowMatching(share_at_t0=0.3)
    options: dict[str, Any] = {**BATCH, "loss": loss, "seed": seed, "progress": False}
    return fit(network, data, coupling, steps=steps, **options).network


def reflowed(rows: Dataset, pairs: str, seed: int) -> Any:
    """A student on the pairs of a teacher; the teacher's pairs cost forward passes as well."""
    teacher = trained_flow(rows, STEPS // 2, Independent(), seed)
    generator = torch.Generator().manual_seed(seed + 77)
    assert rows.c is not None
    x0, x1 = torch.randn(len(rows), 2, generator=generator), rows.x1
    if pairs == "teacher":
        x1 = integrate(teacher, x0, rows.c, nfe=TEACHER_NFE).x1
    else:

        def backwards(t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
            return -teacher(1 - t, x, c)

        x0 = integrate(backwards, x1, rows.c, nfe=TEACHER_NFE, method="midpoint").x1
    made = TEACHER_NFE * len(rows) / (3 * BATCH["batch_size"])  # in steps
    data = Dataset(x1, rows.c, name=f"{pairs}, {seed}")
    return trained_flow(data, int(STEPS // 2 - made), FixedPairs(x0), seed, teacher)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One cell: the floor, or a training and its scores."""
    data, seed = DATA[key["data"]], key["seed"]
    if key["way"] == "floor":
        return {"floor": score(data.sample_given, data, seed)}
    way = WAYS[key["way"]]
    rows = Dataset(*data.sample(ROWS, generator=torch.Generator().manual_seed(seed)))
    started = time.process_time()
    if key["pairs"] in ("independent", "conditional"):
        plain = VelocityMLP(rows.dim, rows.condition_dim + way.columns, seed=seed, **SIZES)
        steps = int(STEPS / way.cost)
        options: dict[str, Any] = {**BATCH, "loss": way.loss, "seed": seed, "progress": False}
        coupling = coupling_of(key["pairs"], key["data"])
        network: Any = fit(way.network(plain), rows, coupling, steps=steps, **options).network
    else:
        network = reflowed(rows, key["pairs"], seed)
    seconds = time.process_time() - started

    def drawn(nfe: int) -> Any:
        def sample(c: Tensor, generator: torch.Generator | None = None) -> Tensor:
            return way.draw(network, torch.randn(len(c), 2, generator=generator), c, nfe)

        return sample

    scores = {str(nfe): score(drawn(nfe), data, seed) for nfe in way.evaluations}
    return {"squared_w2": scores, "cpu_seconds": round(seconds, 1)}


def main() -> None:
    """Fills the table."""
    protocol = {"steps": STEPS, "rows": ROWS, "teacher_nfe": TEACHER_NFE, "draws": DRAWS}
    table = opened(__doc__ or "", {**protocol, **BATCH, **SIZES})
    keys = [
        {"data": data, "way": way, "pairs": pairs, "seed": seed}
        for seed, data, way in product(SEEDS, DATA, ("floor", *WAYS))
        for pairs in (WAYS[way].pairs if way in WAYS else ("",))
    ]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
