"""Is the coupling that `recommend` picks the one that training would have picked?

Four conditional tasks on data that nobody here made, all of scikit-learn (see
`cotlearn.datasets.sklearn_task`). Every candidate of `recommend` is trained, same network and same
budget, with three seeds, and scored on held-out rows: the energy score at 1, 2 and 16 evaluations.
The recommendation sees the training rows only. Its regret is its score less that of the candidate
that turned out best, in percent of the latter.

    python benchmarks/your_data.py

writes data/results/your_data.json cell by cell; a run that was stopped goes on where it was. The
rule of recommend was settled on other data (petals, fork, digits by label, windows of Push-T and of
the arm's ring) before any of these networks was scored. All of it takes about 7 CPU minutes.
"""

import functools
from typing import Any

import numpy as np
import torch
from cells import opened

from cotlearn.datasets import SKLEARN_TASKS, Dataset, sklearn_task
from cotlearn.diagnostics import Recommendation, recommend
from cotlearn.diagnostics.recommendation import candidates
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import bootstrap_interval, energy_score

NFE = (1, 2, 16)
SETTING = {
    "width": 128,
    "depth": 3,
    "steps": 600,
    "batch_size": 256,
    "seeds": 3,
    "nfe": NFE,
    "draws": 16,
    "test_rows": 500,
    "recommend": {"rows": 2048, "probe_steps": 500, "seed": 0},
}
RULES = {
    "probe": "the rule of recommend: best held-out score of the probe without significant skew",
    "neighbours": "least foreseen one-step error by nearest neighbours without significant skew, "
    "independent if that is not below 80 %: the rule that recommend had before",
    "variance": "least one-step variance without significant skew",
    "probe alone": "best held-out score of the probe, skewed or not; looked at only after one seed "
    "of digits_lower and diabetes was seen",
    "independent": "always independent pairs",
    "naive OT": "always naive OT",
}


@functools.cache
def data(name: str) -> tuple[Dataset, Dataset]:
    """Training and held-out rows."""
    return sklearn_task(name)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """A recommendation, or one network trained and scored."""
    train, test = data(key["data"])
    assert train.c is not None
    assert test.c is not None
    if key["coupling"] == "recommend":
        advice = recommend(train.x1, train.c, progress=False, **SETTING["recommend"])
        return {"picks": picks(advice), "reason": advice.reason, "frontier": points(advice)}
    seed, rows = key["seed"], slice(0, SETTING["test_rows"])
    start = VelocityMLP(
        train.dim,
        train.condition_dim,
        width=SETTING["width"],
        depth=SETTING["depth"],
        seed=seed,
    )
    coupling = candidates(train.x1, train.c)[key["coupling"]]
    network = fit(
        start,
        train,
        coupling,
        steps=SETTING["steps"],
        batch_size=SETTING["batch_size"],
        seed=seed,
    ).network
    scores = []
    for nfe in NFE:
        draw, g = sampler(network, nfe=nfe), torch.Generator().manual_seed(1000 + seed)
        c = test.c[rows]
        drawn = torch.stack([draw(c, generator=g) for _ in range(SETTING["draws"])])
        scores.append(round(energy_score(drawn, test.x1[rows]), 5))
    return {"energy_score": scores}


def picks(advice: Recommendation) -> dict[str, str]:
    """What each rule takes from the same frontier."""
    found = advice.frontier
    clean = [p for p in found if not p.flagged]
    near = min(clean, key=lambda p: p.one_step_error)
    useful = near.one_step_error <= 0.8 * found["independent"].one_step_error
    return {
        "probe": advice.name,
        "neighbours": near.name if useful else "independent",
        "probe alone": min(found, key=lambda p: p.one_step_score).name,
        "variance": min(clean, key=lambda p: p.one_step_variance).name,
        "independent": "independent",
        "naive OT": "naive OT",
    }


def points(advice: Recommendation) -> list[dict[str, Any]]:
    """The frontier, JSON-compatible."""
    columns = ("skew", "one_step_variance", "one_step_error", "one_step_score", "candidates")
    return [
        {"name": p.name, "flagged": p.flagged}
        | {"linear_skew": None if p.linear_skew is None else round(p.linear_skew.explained, 5)}
        | {column: round(getattr(p, column), 5) for column in columns}
        for p in advice.frontier
    ]


def judged(cells: list[dict[str, Any]]) -> dict[str, Any]:
    """Regret of every rule: per data set and NFE, mean over seeds; and over all data sets."""
    scores: dict[str, dict[str, list[list[float]]]] = {}
    picked: dict[str, dict[str, str]] = {}
    for cell in cells:
        name, coupling = cell["key"]["data"], cell["key"]["coupling"]
        if coupling == "recommend":
            picked[name] = cell["picks"]
        else:
            scores.setdefault(name, {}).setdefault(coupling, []).append(cell["energy_score"])
    each: dict[str, Any] = {}
    for name, table in scores.items():
        means = {coupling: np.mean(seeds, axis=0) for coupling, seeds in table.items()}
        best = [min(means, key=lambda k, j=j: means[k][j]) for j in range(len(NFE))]
        each[name] = {"best": best, "regret": {}}
        for rule, choice in picked[name].items():
            rows = []
            for j, winner in enumerate(best):
                lost = np.array(table[choice])[:, j] - np.array(table[winner])[:, j]
                percent = 100 * lost / means[winner][j]
                low, high = bootstrap_interval(percent)
                rows.append([round(float(v), 2) for v in (percent.mean(), low, high)])
            each[name]["regret"][rule] = rows
    overall = {}
    for rule in RULES:
        values = np.array([[row[0] for row in one["regret"][rule]] for one in each.values()])
        overall[rule] = [
            [round(float(v), 2) for v in (column.mean(), *bootstrap_interval(column))]
            for column in values.T
        ]
    return {"each": each, "mean_over_data_sets": overall}


def main() -> None:
    """Fill the table, judge, print."""
    torch.set_num_threads(1)
    table = opened(__doc__, {**SETTING, "rules": RULES})
    keys: list[dict[str, Any]] = []
    for seed in range(int(SETTING["seeds"])):
        for name in SKLEARN_TASKS:
            train, _ = data(name)
            assert train.c is not None
            if seed == 0:
                keys.append({"data": name, "coupling": "recommend", "seed": 0})
            keys += [
                {"data": name, "coupling": coupling, "seed": seed}
                for coupling in candidates(train.x1, train.c)
            ]
    table.fill(keys, compute)
    table.document["judged"] = judged(table.document["cells"])
    table.write()
    for rule, rows in table.document["judged"]["mean_over_data_sets"].items():
        words = "  ".join(f"NFE {n}: {r[0]:5.1f} %" for n, r in zip(NFE, rows, strict=True))
        print(f"{rule:14s}{words}")


if __name__ == "__main__":
    main()
