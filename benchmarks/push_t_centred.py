"""What does a regression, taken off before pairing, do for strata of any number on Push-T?

Policies with noise paired within strata of states, from one (which is naive OT of 1,024 windows at
a time) to 1,024, by what a regression on the state leaves over of the chunks. Coverage at 1, 2 and
16 evaluations, and beside it how much of the noise of training the condition foretells. Data,
budget and starts as in `push_t_strata.py`, which has strata of the chunks themselves.

    python benchmarks/push_t_centred.py

writes data/results/push_t_centred.json. An interrupted run goes on.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict
from typing import Any

import torch
from cells import RESULTS, Table
from push_t_strata import SETTING as STRATA
from short_training import rolled

from cotlearn.assets import find_data
from cotlearn.couplings.base import generator_for
from cotlearn.diagnostics import linear_skew
from cotlearn.robots.benchmark.choice import seen_by
from cotlearn.robots.episodes import read, split
from cotlearn.robots.training import Options, train

SETTING = {
    **{name: STRATA[name] for name in ("steps", "batch_size", "seed", "held_out", "rollouts")},
    "pairs": 20_000,
}
CLUSTERS = (1, 64, 1024)


def main() -> None:
    """Fills the table."""
    torch.set_num_threads(1)
    episodes = read(find_data("push_t_demos.npz"))
    training, _ = split(episodes, held_out=SETTING["held_out"])
    table = Table(
        RESULTS / "push_t_centred.json",
        question="What does a regression, taken off before pairing, do for strata of any number?",
        protocol=SETTING,
    )

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        options = Options(
            frame="body",
            steps=SETTING["steps"],
            batch_size=SETTING["batch_size"],
            clusters=key["clusters"],
        )
        trained = train(key["method"], training, seed=SETTING["seed"], options=options)
        stream = trained.coupling.stream(
            seen_by(training, options),
            batch_size=SETTING["batch_size"],
            generator=generator_for(SETTING["seed"], 1),
        )
        some = list(itertools.islice(stream, SETTING["pairs"] // SETTING["batch_size"]))
        x0, c = torch.cat([p.x0 for p in some]), torch.cat([p.c for p in some])
        skews = {
            "linear": linear_skew(x0, c),
            "quadratic": linear_skew(x0, c, degree=2),
            "of_squares": linear_skew(x0.square(), c, degree=2),
        }
        return {
            **rolled(trained, rollouts=SETTING["rollouts"]),
            "explained": {name: asdict(skew) for name, skew in skews.items()},
        }

    table.fill([{"method": "centred", "clusters": k} for k in CLUSTERS], compute)


if __name__ == "__main__":
    main()
