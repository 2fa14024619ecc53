"""Which pairs are best when one samples with classifier-free guidance?

Elsewhere pairs that ignore the class were reported to win under guidance. Here: petals with 4 and
with 8 labels, a network that is trained with a fifth of the labels hidden, on independent pairs, on
pairs blind to the label (naive OT) and on pairs within labels (COT); then a sweep over the guidance
scale and the number of Euler steps. Each guided step evaluates the network twice.

    python benchmarks/guidance.py

writes data/results/guidance.json cell by cell; a run that was stopped goes on where it was. Scores,
each over (scale, steps): `squared_w2` per condition; `right`, the share of samples that are most
probable under the label they were asked for; `spread`, the trace of the samples' covariance within
a label over that of the data.
"""

import math
from collections.abc import Callable
from typing import Any

import torch
from cells import opened
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT
from cotlearn.flows import Guided, LabelDropout, VelocityMLP, fit, sampler
from cotlearn.metrics import squared_w2
from cotlearn.mixtures import petals

LABELS = (4, 8)
SCALES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)
STEPS = (1, 2, 4, 16)
SETTING = {
    "training_steps": 1000,
    "batch_size": 256,
    "width": 128,
    "hidden_labels": 0.2,
    "samples_per_label": 300,
    "seeds": 3,
    "labels": LABELS,
    "scales": SCALES,
    "steps": STEPS,
}
COUPLINGS: dict[str, Callable[[], Coupling]] = {
    "independent": Independent,
    "minibatch_ot": MinibatchOT,
    "conditional_ot": lambda: ConditionalOT(math.inf),
}


def measure(x: Tensor, truth: Tensor, data: Any, label: Tensor) -> tuple[float, float, float]:
    """Squared W2, share of the right label, and spread, of samples of one label."""
    others = data.conditions()
    logs = torch.stack([data.log_density(x, other.expand(len(x), -1)) for other in others])
    own = (others == label).all(dim=1)
    right = own[logs.argmax(dim=0)].float().mean()
    return squared_w2(x, truth), float(right), float(x.var(dim=0).sum() / truth.var(dim=0).sum())


def score(draw: Callable[..., Tensor], data: Any, seed: int) -> list[float]:
    """The three scores, averaged over labels."""
    g = torch.Generator().manual_seed(1000 + seed)
    values = []
    for label in data.conditions():
        c = label.expand(int(SETTING["samples_per_label"]), -1)
        truth = data.sample_given(c, generator=g)
        values.append(measure(draw(c, generator=g), truth, data, label))
    return [round(sum(column) / len(column), 4) for column in zip(*values, strict=True)]


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """The floor of true samples, or one network trained and scored."""
    data, seed = petals(key["labels"]), key["seed"]
    names = ("squared_w2", "right", "spread")
    if key["coupling"] == "truth":
        return dict(zip(names, score(data.sample_given, data, seed), strict=True))
    network = fit(
        VelocityMLP(2, key["labels"], width=SETTING["width"], seed=seed),
        data,
        COUPLINGS[key["coupling"]](),
        steps=SETTING["training_steps"],
        batch_size=SETTING["batch_size"],
        loss=LabelDropout(SETTING["hidden_labels"]),
        seed=seed,
    ).network
    rows = {
        scale: {n: score(sampler(Guided(network, scale), nfe=n, dim=2), data, seed) for n in STEPS}
        for scale in SCALES
    }
    return {
        name: {scale: {n: row[n][k] for n in STEPS} for scale, row in rows.items()}
        for k, name in enumerate(names)
    }


def main() -> None:
    """Fill the table and print the errors."""
    table = opened(__doc__, SETTING, axis="scale steps")
    table.fill(
        [
            {"labels": labels, "coupling": coupling, "seed": seed}
            for seed in range(int(SETTING["seeds"]))
            for labels in LABELS
            for coupling in ("truth", *COUPLINGS)
        ],
        compute,
    )
    columns = ["labels", "coupling", "steps"]
    means = table.frame().groupby([*columns, "scale"])["squared_w2"].mean()
    print(means.unstack("scale").to_string())


if __name__ == "__main__":
    main()
