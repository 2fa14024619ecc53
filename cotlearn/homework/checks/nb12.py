"""The checks of notebook 12."""

from typing import Any

import numpy as np
import torch

from cotlearn.homework.checks.common import Case, Cases, table


@table("12.decide")
def decide() -> Cases:
    """The best coupling without skew if it beats independent pairs by two standard errors."""
    for sure, gains, right in (
        (9.0, {"naive OT": 0.3, "COT": -0.1, "strata": 0.2}, "strata"),
        (9.0, {"naive OT": 0.3, "COT": 0.02, "strata": 0.05}, "strata"),
        (2.2, {"naive OT": 0.3, "COT": 0.02, "strata": -0.05}, "COT"),
        (2.2, {"naive OT": 3.0, "COT": -0.1, "strata": 0.2}, "strata"),
        (1.8, {"naive OT": 0.3, "COT": 0.02, "strata": -0.1}, "independent"),
        (1.8, {"naive OT": 3.0, "COT": 0.2, "strata": -0.1}, "independent"),
        (9.0, {"naive OT": 0.3, "COT": -0.2}, "independent"),
        (0.1, {"COT": 1e-300}, "independent"),  # equal scores: ahead by nothing
    ):
        yield _decision(gains, right, sure)


def _decision(gains: dict[str, float], right: str, sure: float) -> Case:
    """Scores whose best clean gain is `sure` standard errors; smaller gains are surer."""
    row = np.random.default_rng(12).gamma(4.0, 0.25, size=100)  # what every coupling finds hard
    clean = {name: gain for name, gain in gains.items() if name != "naive OT"}
    noise = 10 / sure / abs(max(clean.values())) * np.resize([1.0, -1.0], 100)
    scores = {k: row - gain + gain**2 * noise for k, gain in gains.items()} | {"independent": row}
    clean["independent"] = 0
    wrong: dict[str, Any] = {"naive OT is flagged: leave it out first": "naive OT"}
    if (worst := min(clean, key=clean.__getitem__)) not in (right, "independent"):
        wrong["small scores are good"] = worst
    for name in clean:
        if name != right and 0 < clean[name] < clean.get(right, 0):
            wrong[f"{name} is better than independent pairs, but {right} is better still"] = name
    if right == "independent":
        hint = f"the best is ahead by {sure} standard errors, not by two: stay with 'independent'"
        return Case((scores, {"naive OT"}), right, wrong, hint)
    hint = f"{right} is the best without a flag, and ahead by {sure} standard errors"
    wrong[f"{hint} of the differences row by row, std / sqrt(n)"] = "independent"
    return Case((scores, {"naive OT"}), right, wrong)


@table("12.guided", seed=12)
def guided(g: torch.Generator) -> Cases:
    """The guided velocity, without + scale (with - without)."""
    with_label, without = torch.randn(2, 6, 2, generator=g)
    step = with_label - without
    for scale in (2.5, 1.0, 0.0):
        wrong = {
            "the difference is with the label minus without": without - scale * step,
            "scale is not used": with_label,
            "this is scale + 1: scale 1 is the velocity with the label": with_label + scale * step,
            "scale 1 is the velocity with the label, 0 without": with_label - scale * step,
            "the velocity without the label is needed, too": scale * with_label,
            "it is the difference of the two that is scaled": without + scale * with_label,
        }
        right = without + scale * step
        yield Case((with_label, without, scale), right, wrong, what="the velocity")
