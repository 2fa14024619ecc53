"""Which noise does a flow have for a chunk? It depends on the solver that goes backwards.

A flow of human demonstrations (independent pairs, velocity, 3,000 steps) is inverted for chunks of
its own, for chunks that it was trained on, and for held-out ones. Its own chunks are made by 128
midpoint steps, so an exact inversion returns their noise, with mean square 1. Near t = 1 the field
is steep, because in some directions chunks hardly vary: few steps stay too near to 0 there.

    python benchmarks/inversion.py --data push_t_human.zarr

writes data/results/inversion.csv.
"""

import argparse
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import torch
from cells import opened
from torch import Tensor

from cotlearn.datasets import Dataset
from cotlearn.flows.solvers import integrate
from cotlearn.policies.methods import METHODS
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.robots.episodes import read, split

STEPS, ROWS = 3000, 2000
SOLVERS = [("euler", n) for n in (16, 64, 256)] + [("midpoint", n) for n in (16, 32, 64, 256)]


def some(data: Dataset) -> Dataset:
    """Random rows."""
    rows = torch.randperm(len(data), generator=torch.Generator().manual_seed(0))[:ROWS]
    assert data.c is not None
    return Dataset(data.x1[rows], data.c[rows])


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="people's demonstrations")
    asked = parser.parse_known_args()[0]

    @cache
    def trained() -> tuple[Any, dict[str, Dataset]]:
        setting = SETTINGS["push-t-human"]
        training, held = split(read(asked.data), held_out=setting.held_out)
        options = replace(setting.options, steps=STEPS)
        policy = train(METHODS["independent"], training, options=options).policy
        kinds = {"training": training, "held_out": held}
        label = options.label
        return policy.network, {
            k: some(policy.windows.dataset(e, label=label)) for k, e in kinds.items()
        }

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        network, rows = trained()

        def backwards(t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
            return -network(1 - t, x, c)

        noise = torch.randn(ROWS, rows["training"].dim, generator=torch.Generator().manual_seed(1))
        c = rows["training"].c
        own = Dataset(integrate(network, noise, c, nfe=256, method="midpoint").x1, c)
        found = {}
        for name, data in {"own": own, **rows}.items():
            x0 = integrate(backwards, data.x1, data.c, nfe=key["nfe"], method=key["solver"]).x1
            found[name] = round(float(x0.square().mean()), 4)
            if name == "own":
                found["own_error"] = round(float((x0 - noise).square().mean()), 5)
        return {"mean_square": found}

    protocol = {"steps": STEPS, "rows": ROWS}
    table = opened(__doc__ or "", protocol, parser=parser)
    table.fill([{"solver": name, "nfe": nfe} for name, nfe in SOLVERS], compute)


if __name__ == "__main__":
    main()
