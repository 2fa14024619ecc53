"""Do skews that are computed before training predict what couplings cost on Push-T?

For couplings that policies in `data/results/study.csv` were trained with (sources `push_t_velocity`
and `push_t_strata`), the skew of 20,000 pairs by near neighbours and by regression. Nothing is
trained.

    python benchmarks/push_t_skew.py

writes data/results/push_t_skew.csv. An interrupted run goes on.
"""

import itertools
from dataclasses import asdict
from typing import Any

import torch
from cells import opened

from cotlearn.course.assets import find_data
from cotlearn.diagnostics import linear_skew, prior_skew
from cotlearn.policies.choice import seen_by
from cotlearn.policies.methods import find_method
from cotlearn.policies.options import Options
from cotlearn.randomness import generator_for
from cotlearn.robots.episodes import read, split

SETTING = {"rows": 20_000, "batch_size": 512, "seed": 0, "held_out": 200}
WEIGHTS = (5.33, 16.0, 53.3)  #: what `cotlearn bench push-t` took, 3 and 10 times as much
EPISODES, CLUSTERS = (500, 1000, 3800), (64, 1024, 8192)
EVERY = max(EPISODES)  #: all episodes that are not held out


def main() -> None:
    """Fills the table."""
    episodes = read(find_data("push_t_demos.npz"))
    table = opened(
        "Do skews that are computed before training predict what couplings cost?",
        SETTING,
    )

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        training, _ = split(episodes, held_out=SETTING["held_out"], train=key["episodes"])
        value = {key["option"]: key["value"]} if key["option"] else {}
        options = Options(frame="body", **value)
        data = seen_by(training, options)
        stream = (
            find_method(key["method"])
            .coupling(options, None)
            .stream(
                data,
                batch_size=SETTING["batch_size"],
                generator=generator_for(SETTING["seed"], 0),
            )
        )
        count = SETTING["rows"] // SETTING["batch_size"]
        pairs = list(itertools.islice(stream, count))
        x0, c = torch.cat([p.x0 for p in pairs]), torch.cat([p.c for p in pairs])
        near = prior_skew(x0, c, generator=generator_for(SETTING["seed"], 1))
        return {
            "neighbours": asdict(near),
            "linear": asdict(linear_skew(x0, c)),
            "quadratic": asdict(linear_skew(x0, c, degree=2)),
        }

    none = {"option": None, "value": None}
    weight, strata = {"option": "condition_weight"}, {"option": "clusters"}
    keys: list[dict[str, Any]] = [
        {"method": "independent", "episodes": EVERY, **none},
        {"method": "minibatch_ot", "episodes": EVERY, **none},
        *({"method": "conditional_ot", "episodes": EVERY, **weight, "value": w} for w in WEIGHTS),
        *(
            {"method": method, "episodes": EVERY, **strata, "value": 4096}
            for method in ("stratified", "residual")
        ),
        *(
            {"method": "stratified", "episodes": n, **strata, "value": k}
            for n in EPISODES
            for k in CLUSTERS
        ),
    ]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
