"""Is the coupling that `recommend` picks the one that training would have picked?

Four conditional tasks on data that nobody here made, all of scikit-learn (see
`sklearn_task`). Every candidate of `recommend` is trained, same network and same
budget, with three seeds, and scored on held-out rows: the energy score at 1, 2 and 16 evaluations.
The recommendation sees the training rows only. Its regret is its score less that of the candidate
that turned out best, in percent of the latter.

    python benchmarks/your_data.py

writes the scores to data/results/your_data.csv, and to your_data_recommended.csv what `recommend`
says of each candidate and which rules take it. An interrupted run goes on. The rule of recommend
was settled on other data (petals, fork, digits by label, windows of Push-T and of the arm's ring)
before any of these networks was scored. All of it takes about 7 CPU minutes.
"""

import functools
from typing import Any

import numpy as np
import torch
from cells import beside, opened
from numpy.typing import NDArray
from sklearn import datasets

from cotlearn.datasets import Dataset, Standardiser
from cotlearn.diagnostics import Recommendation, recommend
from cotlearn.diagnostics.recommendation import candidates
from cotlearn.flows import VelocityMLP, fit, sampler
from cotlearn.metrics import energy_score

SKLEARN_TASKS = ("digits_lower", "diabetes", "breast_cancer", "flower")
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


def sklearn_task(name: str) -> tuple[Dataset, Dataset]:
    """Data of scikit-learn as conditional tasks, as training data and held-out data.

    - digits_lower: the lower half of a digit (32 grey values) given the upper half; 1,797 rows.
    - diabetes: disease progression, body mass and blood pressure of a patient given eight other
      measurements; 442 rows.
    - breast_cancer: 30 measurements of a tumour given its diagnosis, two labels; 569 rows.
    - flower: the two colour differences of a photograph's pixel (blue and red minus brightness)
      given the brightness of the 3 x 3 pixels around it; 6,000 pixels.

    Columns of x1 and of numeric conditions are standardised. Grey values and brightness share one
    scale, so that pixels that hardly vary are not amplified. Every fourth row is held out.

    Args:
        name: one of `SKLEARN_TASKS`.

    Returns:
        The training and the held-out `Dataset`.
    """
    if name == "digits_lower":
        images = datasets.load_digits().data
        x1, c = _one_scale(images[:, 32:]), _one_scale(images[:, :32])
    elif name == "diabetes":
        table, target = datasets.load_diabetes(return_X_y=True)
        wanted = np.isin(np.arange(table.shape[1]), (2, 3))
        x1, c = _columns(np.column_stack([target, table[:, wanted]])), _columns(table[:, ~wanted])
    elif name == "breast_cancer":
        table, target = datasets.load_breast_cancer(return_X_y=True)
        x1, c = _columns(table), np.eye(2)[target]
    else:
        x1, c = _flower(datasets.load_sample_image("flower.jpg"))
    rows = np.random.default_rng(0).permutation(len(x1))
    x, condition = (torch.from_numpy(values[rows]).float() for values in (x1, c))
    held_out = torch.arange(len(x)) % 4 == 3
    train, test = (Dataset(x[part], condition[part], name) for part in (~held_out, held_out))
    return train, test


def _flower(image: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Colour differences (6000, 2) and 3 x 3 brightness (6000, 9) of random pixels of an image."""
    red, green, blue = np.moveaxis(image.astype(np.float64) / 255, 2, 0)
    light = 0.299 * red + 0.587 * green + 0.114 * blue  # ITU-R BT.601
    around = np.lib.stride_tricks.sliding_window_view(light, (3, 3)).reshape(-1, 9)
    colour = np.stack([blue - light, red - light], axis=2)[1:-1, 1:-1].reshape(-1, 2)
    rows = np.random.default_rng(0).choice(len(colour), 6000, replace=False)
    return _columns(colour[rows]), _one_scale(around[rows])


def _columns(table: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(Standardiser.fit(table)(table))


def _one_scale(table: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = table - table.mean(axis=0)
    return np.asarray(centred / np.sqrt((centred**2).mean()))


@functools.cache
def data(name: str) -> tuple[Dataset, Dataset]:
    """Training and held-out rows."""
    return sklearn_task(name)


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One network trained and scored."""
    train, test = data(key["data"])
    assert train.c is not None
    assert test.c is not None
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
    scores = {}
    for nfe in NFE:
        draw, g = sampler(network, nfe=nfe), torch.Generator().manual_seed(1000 + seed)
        c = test.c[rows]
        drawn = torch.stack([draw(c, generator=g) for _ in range(SETTING["draws"])])
        scores[nfe] = round(energy_score(drawn, test.x1[rows]), 5)
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


def recommended(key: dict[str, Any]) -> list[dict[str, Any]]:
    """What `recommend` says of each candidate, and which rules take it."""
    train, _ = data(key["data"])
    advice = recommend(train.x1, train.c, progress=False, **SETTING["recommend"])
    columns = ("skew", "one_step_variance", "one_step_error", "one_step_score", "candidates")
    taken = picks(advice)
    return [
        {"coupling": p.name, "flagged": p.flagged}
        | {"linear_skew": None if p.linear_skew is None else round(p.linear_skew.explained, 5)}
        | {column: round(getattr(p, column), 5) for column in columns}
        | {rule: taken[rule] == p.name for rule in RULES}
        | {"reason": advice.reason if p.name == advice.name else None}
        for p in advice.frontier
    ]


def main() -> None:
    """Fill both tables."""
    table = opened(__doc__, {**SETTING, "rules": RULES}, axis="nfe")
    question = "What does `recommend` say of each candidate, and which of them does a rule take?"
    beside(table, "recommended", question).fill([{"data": n} for n in SKLEARN_TASKS], recommended)
    keys = [
        {"data": name, "coupling": coupling, "seed": seed}
        for seed in range(int(SETTING["seeds"]))
        for name in SKLEARN_TASKS
        for coupling in candidates(data(name)[0].x1, data(name)[0].c)
    ]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
