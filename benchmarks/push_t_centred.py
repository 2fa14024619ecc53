"""What does a regression, subtracted before pairing, do for strata of any number on Push-T?

Policies with noise paired within strata of states, from one (which is naive OT of 1,024 windows at
a time) to 1,024, by the residuals of a regression of the chunks on the state: that of a network,
trained for a fifth of the steps, or a quadratic one in closed form. Coverage at 1, 2 and 16
evaluations, and beside it how much of the noise of training the condition predicts. Data, budget
and starts as in `push_t_strata.py`, which has strata of the chunks themselves.

    python benchmarks/push_t_centred.py

writes data/results/push_t_centred.json. An interrupted run goes on.
"""

import itertools
from dataclasses import asdict, replace
from typing import Any

import torch
from cells import opened
from push_t_strata import SETTING as STRATA
from short_training import rolled
from torch import Tensor

from cotlearn.assets import find_data
from cotlearn.couplings import StratifiedOT, centred
from cotlearn.couplings.base import generator_for
from cotlearn.diagnostics import linear_skew
from cotlearn.policies.comparison.choice import seen_by
from cotlearn.policies.methods import find_method
from cotlearn.policies.training import Options, train
from cotlearn.robots.episodes import read, split

SETTING = {
    **{name: STRATA[name] for name in ("steps", "batch_size", "seed", "held_out", "rollouts")},
    "pairs": 20_000,
}
CLUSTERS = (1, 64, 1024)


class QuadraticMean:
    """The regression of x1 on the columns of c, their squares and products, by least squares."""

    def fit(self, x1: Tensor, c: Tensor) -> None:
        """With a ridge of one row, once features are scaled."""
        self.centre, self.scale = c.double().mean(dim=0), c.double().std(dim=0)
        features = self.features(c)
        ridge = torch.eye(features.shape[1], dtype=torch.float64)
        ridge[0, 0] = 0  # of the constant
        self.weights = torch.linalg.solve(features.T @ features + ridge, features.T @ x1.double())

    def features(self, c: Tensor) -> Tensor:
        """1, the scaled columns, their squares and products."""
        z = (c.double() - self.centre) / self.scale
        products = [z[:, [i]] * z[:, i:] for i in range(z.shape[1])]
        return torch.cat([torch.ones_like(z[:, :1]), z, *products], dim=1)

    def __call__(self, c: Tensor) -> Tensor:
        """The mean chunk in states c."""
        return (self.features(c) @ self.weights).float()


def main() -> None:
    """Fills the table."""
    episodes = read(find_data("push_t_demos.npz"))
    training, _ = split(episodes, held_out=SETTING["held_out"])
    table = opened(
        "What does a regression, subtracted before pairing, do for strata of any number?",
        SETTING,
    )

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        options = Options(
            frame="body",
            steps=SETTING["steps"],
            batch_size=SETTING["batch_size"],
            clusters=key["clusters"],
        )
        data = seen_by(training, options)
        method = find_method(key["method"])
        if key.get("mean") == "quadratic":
            mean = QuadraticMean()
            mean.fit(data.x1, data.c)
            coupling = centred(StratifiedOT(key["clusters"]), mean)
            method = replace(method, coupling=lambda *_: coupling, prepare=None)
        trained = train(method, training, seed=SETTING["seed"], options=options)
        stream = trained.coupling.stream(
            data,
            batch_size=SETTING["batch_size"],
            generator=generator_for(SETTING["seed"], 1),
        )
        some = list(itertools.islice(stream, SETTING["pairs"] // SETTING["batch_size"]))
        x0, c = (torch.cat([getattr(p, name) for p in some]) for name in ("x0", "c"))
        skews = {
            "linear": linear_skew(x0, c),
            "quadratic": linear_skew(x0, c, degree=2),
            "of_squares": linear_skew(x0.square(), c, degree=2),
        }
        return {
            **rolled(trained, rollouts=SETTING["rollouts"]),
            "explained": {name: asdict(skew) for name, skew in skews.items()},
        }

    network = [{"method": "centred", "clusters": k} for k in CLUSTERS]
    table.fill([*network, *({**key, "mean": "quadratic"} for key in network)], compute)


if __name__ == "__main__":
    main()
