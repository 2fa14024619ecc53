"""Which way to few evaluations is best under a condition, at equal cost?

Losses, each on independent pairs and, where it uses the noise, on conditional pairs: flow matching
(also with the weights of mean flows), regression, two passes, mean flow (also without its instants,
with squared errors in the place of the paper's weights, and predicting the data), alpha-flow (also
with squared errors), shortcut, drifting, a learned source; reflow on the pairs of a teacher, and on
real data with the noise that the teacher's inverse gives; a source for each cluster of the data
(COT-FM), which changes the prior; and no training at all: a data row of a near condition. Every
training costs as much as STEPS of flow matching, counted in forward-equivalents (a backward pass is
two); who needs a teacher spends half of that on it. The score is squared W2 for each condition,
averaged. Drifting compares rows of equal conditions; where the condition is a number, its batches
are of strata as large as those of conditional pairs. Which noise it has for which data is the same.

For scikit-learn's digits given the label it is the energy distance of each class from its held-out
images, averaged. Some ways on two data sets are trained at a quarter, half and twice the cost, too:
the column `steps`.

    python benchmarks/one_step.py

writes data/results/one_step.csv. An interrupted run goes on.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import torch
from cells import opened, score
from digits_labels import score as digits_score
from one_step_losses import AlphaFlow, LearnedSource, learned_source_loss
from scipy.optimize import linear_sum_assignment
from sklearn.cluster import KMeans
from torch import Tensor, nn

from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    FixedPairs,
    Independent,
    StratifiedBatches,
    StratifiedOT,
)
from cotlearn.datasets import Dataset, digits
from cotlearn.flows import FlowMatching, VelocityMLP, fit, integrate
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.matching import Loss
from cotlearn.flows.one_step import (
    Drifting,
    MeanFlow,
    MeanVelocity,
    Shortcut,
    TwoPasses,
    jump,
)
from cotlearn.mixtures import (
    Components,
    ConditionalGaussianMixture,
    moving_modes,
    petals,
    rotating_pair,
)

STEPS, ROWS, TEACHER_NFE, STRATA = 4000, 8192, 16, 128
SIZES: dict[str, Any] = {"width": 128, "depth": 3}
BATCH = {"batch_size": 256, "ot_batch_size": 256}
SEEDS, EVALUATIONS = range(5), (1, 2, 4)
BUDGETS, BUDGET_SEEDS, BUDGET_DATA = (1000, 2000, 8000), range(3), ("petals", "rotating_pair")
BUDGET_WAYS = (
    "flow matching, t = 0",
    "MeanFlow, uniform times, squared errors",
    "shortcut model",
    "drifting",
    "reflow",
)
FLOORS = 20  #: draws of a floor, since one of them varies by a third
NEIGHBOURS, CLUSTERS, ROUNDS = 128, 8, 2
SOURCE = 0.6  #: deviation of COT-FM's noise; its data are divided by it, ours is standard normal


def five_gaussians() -> ConditionalGaussianMixture:
    """COT-FM's toy with the number of the Gaussian as condition: (10, 4 (i - 2)), deviation .5."""
    labels = torch.eye(5)

    def components(c: Tensor) -> Components:
        y = 4 * (c.argmax(dim=1) - 2.0)
        means = torch.stack([torch.full_like(y, 10.0), y], dim=1)[:, None] / SOURCE
        return Components(means.new_zeros(len(c), 1), means, torch.full_like(means, 0.5 / SOURCE))

    def conditions(n: int, generator: torch.Generator | None) -> Tensor:
        return labels[torch.randint(5, (n,), generator=generator)]

    return ConditionalGaussianMixture(
        "five_gaussians", 2, 5, components, conditions, lambda n: labels
    )


DATA: dict[str, Any] = {
    "petals": petals(),
    "moving_modes": moving_modes(),
    "rotating_pair": rotating_pair(),
    "five_gaussians": five_gaussians(),
}
LABELS = ("petals", "five_gaussians", "digits")
Draw = Callable[[Any, Tensor, Tensor, int], Tensor]


def euler(network: Any, x0: Tensor, c: Tensor, nfe: int) -> Tensor:
    """Samples by Euler's method, from the source of the network if it has its own."""
    if isinstance(network, LearnedSource):
        return integrate(network, network.source(x0, c), c, nfe=nfe).x1
    if isinstance(network, Clustered):
        return integrate(network.network, network.source(x0, c), c, nfe=nfe).x1
    return integrate(network, x0, c, nfe=nfe).x1


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
    in_strata: bool = False  #: whether batches are of few strata where the condition is a number


WAYS = {
    "flow matching": Way(FlowMatching()),
    "flow matching, t = 0": Way(FlowMatching(share_at_t0=0.3)),
    "flow matching, adaptive weights": Way(FlowMatching(share_at_t0=0.3, power=1.0)),
    "regression": Way(
        regression_loss,
        draw=lambda network, x0, c, nfe: predict(network, x0, c).detach(),
        evaluations=(1,),
        pairs=("independent",),
    ),
    "two passes (MIP)": Way(
        TwoPasses(),
        cost=2,
        draw=lambda network, x0, c, nfe: TwoPasses().sample(network, x0, c),
        evaluations=(2,),
        pairs=("independent",),
    ),
    "MeanFlow": Way(MeanFlow(), 4 / 3, MeanVelocity, by_jumps, columns=1),
    "MeanFlow, no instants": Way(
        MeanFlow(share_instant=0.0), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "MeanFlow, squared errors": Way(MeanFlow(power=0.0), 4 / 3, MeanVelocity, by_jumps, columns=1),
    "MeanFlow, uniform times": Way(
        MeanFlow(uniform=True), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "MeanFlow, uniform times, squared errors": Way(
        MeanFlow(power=0.0, uniform=True), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "MeanFlow, uniform times, predicts the data": Way(
        MeanFlow(uniform=True, prediction="data"),
        4 / 3,
        MeanVelocity,
        lambda network, x0, c, nfe: jump(network, x0, c, nfe=nfe, prediction="data"),
        columns=1,
    ),
    "alpha-flow": Way(AlphaFlow(int(STEPS * 3 / 4)), 4 / 3, MeanVelocity, by_jumps, columns=1),
    "alpha-flow, few instants": Way(
        AlphaFlow(int(STEPS * 3 / 4), share_instant=0.25), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "alpha-flow, squared errors": Way(
        AlphaFlow(int(STEPS * 3 / 4), power=0.0), 4 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "shortcut model": Way(
        Shortcut(share=0.25), 1 + 0.25 * 2 / 3, MeanVelocity, by_jumps, columns=1
    ),
    "drifting": Way(
        Drifting(),
        draw=lambda network, x0, c, nfe: Drifting().sample(network, x0, c),
        evaluations=(1,),
        pairs=("independent",),
        in_strata=True,
    ),
    "learned source": Way(learned_source_loss, 1.1, lambda plain: LearnedSource(plain, seed=0)),
    "reflow": Way(FlowMatching(), pairs=("teacher",)),
    "reflow on real data": Way(FlowMatching(), pairs=("teacher, inverted",)),
    "source of a cluster": Way(FlowMatching(), pairs=("teacher, clustered",)),
    "look-up": Way(FlowMatching(), 0, draw=at_once, evaluations=(1,), pairs=("no",)),
}


def coupling_of(name: str, data: str, *, in_strata: bool = False) -> Coupling:
    """Independent pairs, or conditional ones: exact for labels, in strata for a number."""
    if name == "conditional":
        return ConditionalOT(math.inf) if data in LABELS else StratifiedOT(STRATA)
    if in_strata and data not in LABELS:
        return StratifiedBatches(ROWS // STRATA)
    return Independent()


def rows_of(data: str, seed: int) -> Dataset:
    """What a seed is trained on: fresh rows in 2D, all training images of the digits."""
    if data == "digits":
        return digits("train")
    return Dataset(*DATA[data].sample(ROWS, generator=torch.Generator().manual_seed(seed)))


def score_of(data: str, sample: Any, seed: int) -> float:
    """Squared W2 for each condition, averaged; energy distance for the digits."""
    if data == "digits":
        return sum(digits_score(sample, digits("test"), seed)["energy_distance"]) / 10
    return score(sample, DATA[data], seed)


def trained_flow(data: Any, steps: int, coupling: Coupling, seed: int, start: Any = None) -> Any:
    """A flow with a share of its rows at t = 0."""
    network = start or VelocityMLP(data.dim, data.condition_dim, seed=seed, **SIZES)
    loss = FlowMatching(share_at_t0=0.3)
    options: dict[str, Any] = {**BATCH, "loss": loss, "seed": seed, "progress": False}
    return fit(network, data, coupling, steps=steps, **options).network


def inverted(teacher: Any, rows: Dataset) -> Tensor:
    """The noise from which a flow makes each row."""

    def backwards(t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
        return -teacher(1 - t, x, c)

    return integrate(backwards, rows.x1, rows.c, nfe=TEACHER_NFE, method="midpoint").x1


def near(rows: Dataset, c: Tensor, x0: Tensor) -> Tensor:
    """(B,), for each condition (B, k) a row with one of the nearest; the noise decides which."""
    assert rows.c is not None
    generator, found = torch.Generator().manual_seed(0), []
    for some in c.split(2048):
        distance = torch.cdist(some, rows.c)
        ties = 1e-6 * torch.rand(distance.shape, generator=generator)
        found.append((distance + ties).topk(NEIGHBOURS, largest=False).indices)
    rank = (torch.special.ndtr(x0[:, :1]) * NEIGHBOURS).long().clamp(max=NEIGHBOURS - 1)
    return torch.cat(found).gather(1, rank)[:, 0]


@dataclass
class Clustered:
    """A flow that starts from the Gaussian of a cluster of the data, which a near row names."""

    network: Any
    rows: Dataset
    cluster: Tensor  #: (n,)
    means: Tensor  #: (K, d)
    roots: Tensor  #: (K, d, d), of the covariances

    def start(self, x0: Tensor, cluster: Tensor) -> Tensor:
        """Noise (B, d) that standard normal noise x0 (B, d) becomes."""
        return self.means[cluster] + (self.roots[cluster] @ x0[:, :, None])[:, :, 0]

    def source(self, x0: Tensor, c: Tensor) -> Tensor:
        """The same, of a cluster that goes with the condition."""
        return self.start(x0, self.cluster[near(self.rows, c, x0.flip(1))])


def clustered(rows: Dataset, seed: int) -> Clustered:
    """COT-FM's alternation: the Gaussian of each cluster's inverse, assignment there, training."""
    assert rows.c is not None
    made = ROUNDS * TEACHER_NFE * len(rows) / (3 * BATCH["batch_size"])  # in steps
    flow = trained_flow(rows, STEPS // 2, Independent(), seed)
    both = torch.cat([rows.x1, rows.c], dim=1).numpy()
    cluster = torch.as_tensor(
        KMeans(CLUSTERS, n_init=4, random_state=seed).fit_predict(both)
    ).long()
    generator = torch.Generator().manual_seed(seed + 77)
    members = [(cluster == k).nonzero()[:, 0] for k in range(CLUSTERS)]
    source = Clustered(flow, rows, cluster, torch.zeros(0), torch.zeros(0))
    for _ in range(ROUNDS):
        noise = inverted(source.network, rows)
        source.means = torch.stack([noise[member].mean(dim=0) for member in members])
        source.roots = torch.linalg.cholesky(
            torch.stack([noise[member].T.cov() for member in members]) + 1e-6 * torch.eye(rows.dim)
        )
        x0 = source.start(torch.randn(len(rows), rows.dim, generator=generator), cluster)
        for member in members:
            order = linear_sum_assignment(torch.cdist(rows.x1[member], x0[member]).square())[1]
            x0[member] = x0[member][order]
        steps = int((STEPS // 2 - made) / ROUNDS)
        source.network = trained_flow(rows, steps, FixedPairs(x0), seed, source.network)
    return source


def reflowed(rows: Dataset, pairs: str, seed: int, budget: int) -> Any:
    """A student on the pairs of a teacher; the teacher's pairs cost forward passes as well."""
    teacher = trained_flow(rows, budget // 2, Independent(), seed)
    generator = torch.Generator().manual_seed(seed + 77)
    assert rows.c is not None
    x0, x1 = torch.randn(len(rows), rows.dim, generator=generator), rows.x1
    if pairs == "teacher":
        x1 = integrate(teacher, x0, rows.c, nfe=TEACHER_NFE).x1
    else:
        x0 = inverted(teacher, rows)
    made = TEACHER_NFE * len(rows) / (3 * BATCH["batch_size"])  # in steps
    data = Dataset(x1, rows.c, name=f"{pairs}, {seed}")
    return trained_flow(data, int(budget // 2 - made), FixedPairs(x0), seed, teacher)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One cell: the floor, or a training and its scores."""
    data, seed, budget = key["data"], key["seed"], key["steps"]
    rows = rows_of(data, seed)
    if key["way"] == "floor":
        real = rows if data == "digits" else DATA[data]
        draws = [score_of(data, real.sample_given, 100 * seed + k) for k in range(FLOORS)]
        return {"floor": round(sum(draws) / FLOORS, 4)}
    way = WAYS[key["way"]]
    if key["pairs"] in ("independent", "conditional"):
        plain = VelocityMLP(rows.dim, rows.condition_dim + way.columns, seed=seed, **SIZES)
        steps = int(budget / way.cost)
        options: dict[str, Any] = {**BATCH, "loss": way.loss, "seed": seed, "progress": False}
        coupling = coupling_of(key["pairs"], data, in_strata=way.in_strata)
        network: Any = fit(way.network(plain), rows, coupling, steps=steps, **options).network
    elif key["way"] == "look-up":
        network = lambda t, x0, c: rows.x1[near(rows, c, x0)]  # noqa: E731
    elif key["way"] == "source of a cluster":
        network = clustered(rows, seed)
    else:
        network = reflowed(rows, key["pairs"], seed, budget)

    def drawn(nfe: int) -> Any:
        def sample(c: Tensor, generator: torch.Generator | None = None) -> Tensor:
            return way.draw(network, torch.randn(len(c), rows.dim, generator=generator), c, nfe)

        return sample

    metric = "energy_distance" if data == "digits" else "squared_w2"
    return {metric: {nfe: score_of(data, drawn(nfe), seed) for nfe in way.evaluations}}


def main() -> None:
    """Fills the table."""
    protocol = {"steps": STEPS, "rows": ROWS, "teacher_nfe": TEACHER_NFE, "strata": STRATA}
    protocol |= {"clusters": CLUSTERS, "rounds": ROUNDS, "neighbours": NEIGHBOURS}
    table = opened(__doc__ or "", {**protocol, **BATCH, **SIZES}, axis="nfe")
    cells = [
        *product((*DATA, "digits"), ("floor", *WAYS), (STEPS,), SEEDS),
        *product(BUDGET_DATA, BUDGET_WAYS, BUDGETS, BUDGET_SEEDS),
    ]
    keys = [
        {"data": data, "way": way, "pairs": pairs, "steps": steps, "seed": seed}
        for data, way, steps, seed in cells
        for pairs in (WAYS[way].pairs if way in WAYS else ("",))
    ]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
