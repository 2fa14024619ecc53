"""The checks of notebook 12."""

from typing import Any

import numpy as np
import torch

from cotlearn.homework.checks.common import Array, Case, Cases, table


@table("12.decide")
def decide() -> Cases:
    """The best without skew, if it beats independent pairs by two standard errors."""
    rng = np.random.default_rng(12)
    row = rng.gamma(4.0, 0.25, size=100)  # what every coupling finds hard
    noise = 0.02 * rng.normal(size=(3, 100))
    noise -= noise.mean(axis=1, keepdims=True)
    for gains, right in (
        ({"naive OT": 0.3, "COT": -0.1, "strata": 0.2}, "strata"),
        ({"naive OT": 0.3, "COT": 0.05, "strata": 0.02}, "COT"),
        ({"naive OT": 0.3, "COT": 0.001, "strata": -0.1}, "independent"),
        ({"naive OT": 0.3}, "independent"),
    ):
        others = {name: row - gain + noise[k] for k, (name, gain) in enumerate(gains.items())}
        yield _decision({"independent": row, **others}, right)


def _decision(scores: dict[str, Array], right: str) -> Case:
    means = {name: values.mean() for name, values in scores.items() if name != "naive OT"}
    worst = max(means, key=means.__getitem__)
    wrong: dict[str, Any] = {"naive OT is flagged: leave it out first": "naive OT"}
    if worst != "independent":
        wrong["small scores are good"] = worst
    if right != "independent":
        wrong[
            f"{right} is better by many standard errors; take the standard error of the "
            "differences row by row, std / sqrt(n): the rows are the same"
        ] = "independent"
        return Case((scores, {"naive OT"}), right, wrong)
    hint = "not better than independent pairs by two standard errors: stay with 'independent'"
    return Case((scores, {"naive OT"}), right, wrong, hint)


@table("12.guided", seed=12)
def guided(g: torch.Generator) -> Cases:
    """The velocity without the label, pushed on towards the one with it."""
    with_label, without = torch.randn(2, 6, 2, generator=g)
    step = with_label - without
    for scale in (2.5, 1.0, 0.0):
        wrong = {
            "this is scale + 1: scale 1 is the velocity with the label": with_label + scale * step,
            "scale 1 is the velocity with the label, 0 without": with_label - scale * step,
            "the velocity without the label is needed, too": scale * with_label,
            "it is the difference of the two that is scaled": without + scale * with_label,
        }
        right = without + scale * step
        yield Case((with_label, without, scale), right, wrong, what="the velocity")
