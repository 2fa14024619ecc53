"""What a larger OT batch does to the conditional error of naive OT and of COT.

Petals with four labels. Noise and data are paired in batches of B rows, from 16 to 1,024; the
network trains on 256 rows at a time, whatever B is. The score is the squared W2 for each label at 1
and at 16 Euler steps. Independent pairs are the case B = 1 of both couplings.

    python benchmarks/ot_batch.py

writes data/results/ot_batch.csv cell by cell; a run that was stopped goes on where it was.
"""

import math
from itertools import count
from operator import itemgetter
from typing import Any

import torch
from cells import opened

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT
from cotlearn.couplings.base import Batches, Pairs
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import conditional_squared_w2
from cotlearn.mixtures import petals

NFE = (1, 16)
BATCH = 256
SETTING = {
    "steps": 1000,
    "batch_size": BATCH,
    "width": 128,
    "seeds": 3,
    "nfe": NFE,
    "samples_per_label": 1000,
    "ot_batches": (16, 64, 256, 1024),
}
COUPLINGS: dict[str, Coupling] = {
    "minibatch_ot": MinibatchOT(),
    "conditional_ot": ConditionalOT(math.inf),
}


def batches(coupling: Coupling, rows: int, seed: int) -> Batches:
    """Batches of 256 pairs that were paired `rows` at a time."""
    generator = torch.Generator().manual_seed(seed)
    stream = coupling.stream(petals(), batch_size=rows, generator=generator)
    if rows < BATCH:
        joined = (Pairs.cat([next(stream) for _ in range(BATCH // rows)]) for _ in count())
        return Batches(joined)
    parts = torch.arange(rows).split(BATCH)
    return Batches(pairs.map(itemgetter(part)) for pairs in stream for part in parts)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """The floor of true samples, or one network trained and scored."""
    data, seed = petals(), key["seed"]

    def score(draw: Any) -> float:
        g = torch.Generator().manual_seed(1000 + seed)
        return conditional_squared_w2(draw, data, n=int(SETTING["samples_per_label"]), generator=g)

    if key["coupling"] == "truth":
        return {"squared_w2": dict.fromkeys(NFE, score(data.sample_given))}
    pairs: Any = Independent()
    if key["coupling"] != "independent":
        pairs = batches(COUPLINGS[key["coupling"]], key["rows"], seed)
    options: Any = {"steps": SETTING["steps"], "batch_size": BATCH, "seed": seed}
    network = VelocityMLP(2, 4, width=SETTING["width"], seed=seed)
    network = fit(network, data, pairs, **options, progress=False).network
    return {"squared_w2": {n: round(score(sampler(network, nfe=n)), 4) for n in NFE}}


def main() -> None:
    """Fill the table."""
    seeds, rows = range(int(SETTING["seeds"])), SETTING["ot_batches"]
    pairs = [(name, n) for name in COUPLINGS for n in rows]
    pairs = [("truth", 1), ("independent", 1), *pairs]
    keys = [{"coupling": name, "rows": n, "seed": seed} for seed in seeds for name, n in pairs]
    opened(__doc__, SETTING, axis="nfe").fill(keys, compute)


if __name__ == "__main__":
    main()
