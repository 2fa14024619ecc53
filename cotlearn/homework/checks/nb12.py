"""The checks of notebook 12."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from cotlearn.homework.checks.common import compare, expect_function, tensor
from cotlearn.homework.registry import NotYet, exercise


@exercise("12.decide")
def decide(answer: Any) -> None:
    """The best without skew, if it beats independent pairs by two standard errors."""
    expect_function(answer)
    rng = np.random.default_rng(12)
    row = rng.gamma(4.0, 0.25, size=100)  # what every coupling finds hard
    noise = 0.02 * rng.normal(size=(3, 100))
    noise -= noise.mean(axis=1, keepdims=True)

    def case(gains: dict[str, float]) -> dict[str, Any]:
        others = {name: row - gain + noise[k] for k, (name, gain) in enumerate(gains.items())}
        return {"independent": row, **others}

    for scores, flagged, right in (
        (case({"naive OT": 0.3, "COT": -0.1, "strata": 0.2}), {"naive OT"}, "strata"),
        (case({"naive OT": 0.3, "COT": 0.05, "strata": 0.02}), {"naive OT"}, "COT"),
        (case({"naive OT": 0.3, "COT": 0.001, "strata": -0.1}), {"naive OT"}, "independent"),
        (case({"naive OT": 0.3}), {"naive OT"}, "independent"),
    ):
        found = answer({name: values.copy() for name, values in scores.items()}, set(flagged))
        if found == right:
            continue
        means = {name: float(values.mean()) for name, values in scores.items()}
        clean = {name: mean for name, mean in means.items() if name not in flagged}
        if found in flagged:
            raise NotYet(f"{found} is flagged: leave those out first")
        if found != "independent" and found == max(clean, key=lambda name: clean[name]):
            raise NotYet("small scores are good")
        if right == "independent":
            raise NotYet(
                f"{found} is not better than independent pairs by two standard errors: then stay "
                "with independent"
            )
        if found == "independent":
            raise NotYet(
                f"{right} is better by many standard errors; take the standard error of the "
                "differences row by row, std / sqrt(n): the rows are the same"
            )
        raise NotYet(f"expected {right!r}, got {found!r}")


@exercise("12.guided")
def guided(answer: Any) -> None:
    """The velocity without the label, pushed on towards the one with it."""
    expect_function(answer)
    g = torch.Generator().manual_seed(12)
    with_label, without = torch.randn(2, 6, 2, generator=g)
    for scale in (2.5, 1.0, 0.0):
        found = tensor(answer(with_label.clone(), without.clone(), scale), (6, 2), "the velocity")
        right = without + scale * (with_label - without)
        compare(
            found,
            right,
            (
                (with_label + scale * (with_label - without), "this is scale + 1: at scale 1 it "
                 "must be the velocity with the label"),
                (with_label + scale * (without - with_label), "scale 1 is the velocity with the "
                 "label, and 0 the one without"),
                (scale * with_label, "the velocity without the label is needed, too"),
                (without + scale * with_label, "it is the difference of the two that is scaled"),
            ),
            f"at scale {scale} expected {right[0].tolist()} in the first row, got "
            f"{found[0].tolist()}",
        )  # fmt: skip
