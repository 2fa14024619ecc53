"""COT's condition weight, chosen by the frontier."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cotlearn.couplings import ConditionalOT, Independent
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier
from cotlearn.robots.episodes import Episodes
from cotlearn.robots.training import Options

#: condition weights, see `choose_weight`
FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
FRONTIER_ROWS = 4096  #: pairs looked at for each weight


def choose_weight(data: Dataset, options: Options, *, seed: int = 0) -> dict[str, Any]:
    """COT's condition weight by the frontier, before any training and without any rollout.

    Among multiples of the ratio of sample to condition variance, the weight with the smallest
    one-step variance whose prior skew is not significant; if all are, the least skewed one. (The
    predicted one-step error, which weighs both in few dimensions, says little about chunks: in
    dozens of dimensions no pair has near neighbours, and it is least for independent pairs.)

    Returns:
        "condition_weight", "reason", and the points of the frontier.
    """
    assert data.c is not None
    spread = float(data.c.var(dim=0).sum())
    ratio = (float(data.x1.var(dim=0).sum()) + data.dim) / spread if spread else 1.0
    couplings = {f"{factor:g}": ConditionalOT(factor * ratio) for factor in FACTORS}
    found = frontier(
        data.x1,
        data.c,
        {"independent": Independent(), **couplings},
        batch_size=options.ot_batch_size,
        rows=FRONTIER_ROWS,
        seed=seed,
    )
    points = [point for point in found if point.name in couplings]
    clean = [point for point in points if not point.flagged]
    if clean:
        best = min(clean, key=lambda point: point.one_step_variance)
        reason = "smallest one-step variance without significant skew"
    else:
        best = min(points, key=lambda point: point.skew)
        reason = "every weight skews the prior significantly; this one least"
    return {
        "condition_weight": float(best.name) * ratio,
        "reason": reason,
        "frontier": [
            {
                "factor": point.name,
                "skew": point.skew,
                "flagged": point.flagged,
                "one_step_variance": point.one_step_variance,
                "one_step_error": point.one_step_error,
                "candidates": point.candidates,
            }
            for point in found
        ],
    }


def with_weight(method: str, training: Episodes, options: Options) -> Options:
    """The options with COT's condition weight chosen by the frontier, where that is open."""
    if not needs_weight(method, options):
        return options
    chosen = choose_weight(seen_by(training, options), options)
    return replace(options, condition_weight=chosen["condition_weight"])


def needs_weight(method: str, options: Options) -> bool:
    """Whether the weight is open."""
    return method == "conditional_ot" and options.condition_weight is None


def seen_by(training: Episodes, options: Options) -> Dataset:
    """The rows that a training of these options would see."""
    options = options.fitting(training)
    return options.windows(training).dataset(training, label=options.label)
