"""The checks of notebook 12."""

from typing import Any

import numpy as np
import torch

from .common import Case, Cases, number, table


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


@table("12.regret")
def regret() -> Cases:
    """By how many percent a score is above the smallest."""
    scores = {"independent": 0.5, "COT": 0.4, "strata": 0.45}
    for chosen in ("independent", "strata", "COT"):
        own, best = scores[chosen], 0.4
        wrong = {
            "in percent: times 100": own / best - 1,
            "in percent of the best score": 100 * (own - best) / own,
            "small scores are good: the best is the smallest": 100 * (own / 0.5 - 1),
            "that is the difference; divide it by the best score": 100 * (own - best),
            "subtract the best score first, or 1": 100 * own / best,
        }
        hint = "take what the score has more than the smallest, in percent of the smallest"
        yield Case((chosen, scores), 100 * (own / best - 1), wrong, hint, read=number)


@table("12.kept", seed=12)
def kept(g: torch.Generator) -> Cases:
    """The share of paired rows with the label of the row that they equal."""
    for n, wrong_rows in ((8, 0), (8, 2), (6, 6)):
        x1, y = torch.randn(n, 3, generator=g), torch.arange(n) % 3
        rows = torch.randperm(n, generator=g)[: n - 1]
        labels = y[rows].clone()
        labels[:wrong_rows] = (labels[:wrong_rows] + 1) % 3
        right = float((labels == y[rows]).float().mean())
        wrong = {
            "rows are in another order: look each one up in x1": _same_places(y, labels),
            "that is the share of rows that lost their label": 1 - right,
            "return the share, not the number": float((labels == y[rows]).sum()),
        }
        yield Case((x1, y, x1[rows], labels), right, wrong, read=number, what="the share")


def _same_places(y: torch.Tensor, labels: torch.Tensor) -> float:
    return float((y[: len(labels)] == labels).float().mean())


@table("12.megabytes")
def megabytes() -> Cases:
    """One matrix of n / k rows, four bytes an entry."""
    for n, k in ((1_000_000, 1), (1_000_000, 1000), (12_000, 30)):
        rows = n / k
        wrong = {
            "strata are paired one after the other: one matrix at a time": 4 * rows * n / 1e6,
            "a stratum has n / k rows": 4 * n**2 / 1e6,
            "an entry in single precision has four bytes": rows**2 / 1e6,
            "a megabyte is 10^6 bytes": 4 * rows**2,
            "a megabyte is 10^6 bytes here, not 2^20": 4 * rows**2 / 2**20,
            "the matrix has (n / k) rows and (n / k) columns": 4 * rows / 1e6,
        }
        yield Case((n, k), 4 * rows**2 / 1e6, wrong, read=number, what="the size")
