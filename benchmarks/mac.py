"""Does it help if the model chooses its pairs, and what does that do to the data?

Three parts, all with a batch of 64, the limit of model-aligned coupling (MAC) "full".

"equal" and "unequal": four source Gaussians at (-3, 0), (3, 0), (0, -3), (0, 3) with standard
deviation 0.5 go to two target Gaussians at (0, -6) and (0, 6), without a condition. Each target
mode has half of the data, and the two source modes on the middle line must be split. In "equal"
both targets have standard deviation 0.5; in "unequal" the upper one has 1.5. The number of
Gaussians is that of the MAC authors (2505.23346); places and spreads are the course's.

"grid": the weights and the spacing of the MAC authors' own toy. Four source Gaussians have the
weights .28, .24, .24 and .24, neighbours are 8 apart, and the two targets have .45 and .55. Places
and the standard deviation, 0.5, are the course's: the sources stand in a column, the targets in the
next one. No two sources weigh .45 or .55 together, so a mode must be split. The points that are
scored come from the modes in exact shares.

The share of the generated points above the middle should be 1/2 (in "grid" .55); "astray" is the
share farther than four standard deviations from both modes. In the first two, chance would move the
shares by about 0.01, and the squared W2 by 144 times that: so the points that are scored start in
mirror pairs, (x, y) with (x, -y), and the true ones are half from either mode.

"petals": normal noise to the four petals with labels, MAC "full" with condition weights from 0 (as
published) to 100, beside independent, naive and conditional OT. `skew` is `prior_skew` of the pairs
that the finished network would choose.

    python benchmarks/mac.py

writes data/results/mac.csv. An interrupted run goes on.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from cells import opened
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, ModelAligned
from cotlearn.diagnostics import prior_skew
from cotlearn.flows import VelocityMLP, fit, integrate, sampler
from cotlearn.metrics import conditional_squared_w2, squared_w2
from cotlearn.mixtures import petals

SETTING = {
    "steps": 2000,
    "batch_size": 64,
    "width": 64,
    "depth": 3,
    "seeds": 5,
    "seeds_petals": 3,
    "seeds_grid": 3,
    "points": 2000,
}
NFE = (1, 2, 4, 32)
NFE_GRID = (1, 2, 16)
WARMUP = SETTING["steps"] // 2
SPREAD = {"equal": (0.5, 0.5), "unequal": (0.5, 1.5)}
CENTRES = torch.tensor([[0.0, -6.0], [0.0, 6.0]])
METHODS = ["minibatch_ot", "independent", "aligned_weighted", "aligned_topk", "aligned_full"]
WEIGHTS = (0, 1, 10, 100)
ON_PETALS = [
    "minibatch_ot",
    "independent",
    "conditional_ot",
    *(f"aligned_full_{w}" for w in WEIGHTS),
]
Scores = list[dict[str, float]]


def source(n: int, generator: torch.Generator | None = None) -> Tensor:
    """The four Gaussians of the source."""
    centres = torch.tensor([[-3.0, 0.0], [3.0, 0.0], [0.0, -3.0], [0.0, 3.0]])
    mode = torch.randint(4, (n,), generator=generator)
    return centres[mode] + 0.5 * torch.randn(n, 2, generator=generator)


@dataclass(frozen=True)
class TwoModes:
    """The two Gaussians of the target; half of the data each."""

    std: tuple[float, float]

    def balanced(self, n: int, generator: torch.Generator) -> Tensor:
        """n points, exactly half from either mode."""
        mode = torch.arange(n) % 2
        noise = torch.randn(n, 2, generator=generator)
        return CENTRES[mode] + torch.tensor(self.std)[mode][:, None] * noise

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, None]:
        """Draw n points; there is no condition."""
        mode = torch.randint(2, (n,), generator=generator)
        noise = torch.randn(n, 2, generator=generator)
        return CENTRES[mode] + torch.tensor(self.std)[mode][:, None] * noise, None


@dataclass(frozen=True)
class Modes:
    """Gaussians in a column at x, with standard deviation 0.5."""

    x: float
    y: tuple[float, ...]
    weights: tuple[float, ...]

    @property
    def centres(self) -> Tensor:
        """Shape (modes, 2)."""
        return torch.tensor([[self.x, y] for y in self.y])

    def balanced(self, n: int, generator: torch.Generator) -> Tensor:
        """n points, exactly the weight's share from each mode."""
        counts = (n * torch.tensor(self.weights)).round().long()
        centres = self.centres.repeat_interleave(counts, dim=0)
        return centres + 0.5 * torch.randn(n, 2, generator=generator)

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, None]:
        """Draw n points; there is no condition."""
        mode = torch.multinomial(torch.tensor(self.weights), n, True, generator=generator)
        return self.centres[mode] + 0.5 * torch.randn(n, 2, generator=generator), None

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw n points, as a source."""
        return self.sample(n, generator)[0]


GRID_SOURCE = Modes(0.0, (-12.0, -4.0, 4.0, 12.0), (0.28, 0.24, 0.24, 0.24))
GRID_TARGET = Modes(8.0, (-8.0, 8.0), (0.45, 0.55))


def make(method: str) -> Coupling:
    """The coupling of a cell."""
    if method.startswith("aligned"):
        _, variant, *weight = method.split("_")
        condition_weight = float(weight[0]) if weight else 0.0
        return ModelAligned(variant, warmup_steps=WARMUP, condition_weight=condition_weight)
    return {
        "independent": Independent(),
        "minibatch_ot": MinibatchOT(),
        "conditional_ot": ConditionalOT(math.inf),
    }[method]


def scores(made: Tensor, truth: Tensor, centres: Tensor, std: Tensor) -> dict[str, float]:
    """Of a sample: its error, how much is above the middle, how much is far from both modes."""
    far = (torch.cdist(made, centres) > 4 * std).all(dim=1)
    return {
        "squared_w2": round(squared_w2(made, truth), 4),
        "upper": round(float((made[:, 1] > 0).float().mean()), 4),
        "astray": round(float(far.float().mean()), 4),
    }


def two_modes(key: dict[str, Any]) -> Scores:
    """Train on 4 -> 2 Gaussians; error and shares at every NFE."""
    std = torch.tensor(SPREAD[key["data"]])
    data, seed = TwoModes(SPREAD[key["data"]]), key["seed"]
    generator = torch.Generator().manual_seed(1000 + seed)
    truth = data.balanced(SETTING["points"], generator)
    if key["method"] == "floor":
        return [scores(data.balanced(SETTING["points"], generator), truth, CENTRES, std)]
    network = train(VelocityMLP(2, width=SETTING["width"], seed=seed), data, key, source)
    half = source(SETTING["points"] // 2, generator=generator)
    x0 = torch.cat([half, half * torch.tensor([1.0, -1.0])])
    return at_each(NFE, network, x0, truth, CENTRES, std)


def grid(key: dict[str, Any]) -> Scores:
    """Train on 4 -> 2 Gaussians with the MAC authors' weights; error and shares at every NFE."""
    seed, std = key["seed"], torch.tensor(0.5)
    generator = torch.Generator().manual_seed(1000 + seed)
    truth = GRID_TARGET.balanced(SETTING["points"], generator)
    if key["method"] == "floor":
        fresh = GRID_TARGET.balanced(SETTING["points"], generator)
        return [scores(fresh, truth, GRID_TARGET.centres, std)]
    start = VelocityMLP(2, width=SETTING["width"], seed=seed)
    network = train(start, GRID_TARGET, key, GRID_SOURCE.noise)
    x0 = GRID_SOURCE.balanced(SETTING["points"], generator)
    return at_each(NFE_GRID, network, x0, truth, GRID_TARGET.centres, std)


def at_each(nfes: tuple[int, ...], network: Any, x0: Tensor, *truth: Tensor) -> Scores:
    """The scores at each number of evaluations."""
    return [{"nfe": n} | scores(integrate(network, x0, nfe=n).x1, *truth) for n in nfes]


def train(start: Any, data: Any, key: dict[str, Any], noise: Any, coupling: Any = None) -> Any:
    """The network of one cell."""
    return fit(
        start,
        data,
        coupling or make(key["method"]),
        steps=SETTING["steps"],
        batch_size=SETTING["batch_size"],
        source=noise,
        seed=key["seed"],
    ).network


def labelled(key: dict[str, Any]) -> dict[str, Any]:
    """Train on petals; conditional error at every NFE, and the skew of the pairs at the end."""
    data, seed = petals(), key["seed"]
    generator = torch.Generator().manual_seed(1000 + seed)
    if key["method"] == "floor":
        value = conditional_squared_w2(data.sample_given, data, n=500, generator=generator)
        return {"conditional_squared_w2": round(value, 4)}
    coupling = make(key["method"])
    start = VelocityMLP(2, 4, width=SETTING["width"], seed=seed)
    network = train(start, data, key, None, coupling)
    errors = {
        nfe: conditional_squared_w2(sampler(network, nfe=nfe), data, n=500, generator=generator)
        for nfe in NFE
    }
    coupling.observe(network, SETTING["steps"])
    stream = coupling.stream(data, batch_size=64, generator=torch.Generator().manual_seed(77))
    pairs = [next(stream) for _ in range(32)]
    skew = prior_skew(
        torch.cat([p.x0 for p in pairs]), torch.cat([p.c for p in pairs]), generator=generator
    )
    return {
        "conditional_squared_w2": {nfe: round(e, 4) for nfe, e in errors.items()},
        "skew": round(skew.statistic, 4),
        "skew_flagged": skew.flagged,
        "evaluations_per_step": getattr(coupling, "evaluations", 0),
    }


def compute(key: dict[str, Any]) -> Any:
    """One cell."""
    return {"petals": labelled, "grid": grid}.get(key["data"], two_modes)(key)


def main() -> None:
    """Fill the table and print it."""
    protocol = {**SETTING, "nfe": NFE, "nfe_grid": NFE_GRID, "warmup_steps": WARMUP}
    modes = {"source": asdict(GRID_SOURCE), "target": asdict(GRID_TARGET)}
    table = opened(__doc__, {**protocol, "spread": SPREAD, "grid": modes}, axis="nfe")
    parts = {"equal": METHODS, "unequal": METHODS, "grid": METHODS, "petals": ON_PETALS}
    keys = [
        {"data": data, "method": method, "seed": seed}
        for seed in range(SETTING["seeds"])
        for data, methods in parts.items()
        for method in ["floor", *methods]
        if seed < SETTING.get(f"seeds_{data}", SETTING["seeds"])
    ]
    table.fill(keys, compute)
    scores = ["squared_w2", "upper", "conditional_squared_w2", "skew"]
    print(table.frame().groupby(["data", "method", "nfe"])[scores].mean().to_string())


if __name__ == "__main__":
    main()
