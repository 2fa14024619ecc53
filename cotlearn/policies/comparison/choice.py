"""What the frontier chooses before any training: COT's condition weight, the number of strata."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cotlearn.couplings import Coupling, Independent
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier
from cotlearn.policies.training import Options
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes

#: condition weights, as multiples of the ratio of sample to condition variance
FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
STRATUM_ROWS = (10, 20, 40, 80, 160, 320)  #: rows of a stratum, on average
FRONTIER_ROWS = 4096  #: pairs that are looked at for each value

#: the option of a method that may be left open
_OPEN = {
    "conditional_ot": "condition_weight",
    "stratified": "clusters",
    "residual": "clusters",
    "centred": "clusters",  #: those of "stratified": its regression is not trained yet
}


def choose(
    method: str,
    data: Dataset,
    options: Options,
    *,
    windows: Windows | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """Chooses the open option of a method, without any training or rollout.

    It is the value with the smallest one-step variance whose prior skew is not significant; if all
    are, the least skewed one. (The predicted one-step error, which weighs both in few dimensions,
    says little about chunks: in dozens of dimensions no pair has near neighbours, and it is least
    for independent pairs.)

    Args:
        method: whose option is open.
        data: that the training would see.
        options: of the training.
        windows: that made the data; only options of a camera need them.
        seed: of the frontier.

    Returns:
        "option", "value", "reason", and the points of the "frontier".
    """
    assert data.c is not None
    option = _OPEN[method]
    values: list[Any] = _weights(data) if option == "condition_weight" else _strata(data)
    couplings: dict[str, Coupling] = {"independent": Independent()}
    seen = None
    for value in values:
        changed: dict[str, Any] = {option: value}
        tried = replace(options, **changed)
        if seen is None or option == "clusters":
            seen = tried.condition_of(method, data, windows)
        couplings[f"{value:g}"] = tried.coupling_of(method, seen)
    found = frontier(
        data.x1,
        data.c,
        couplings,
        batch_size=options.ot_batch_size,
        rows=FRONTIER_ROWS,
        seed=seed,
    )
    points = list(zip(values, list(found)[1:], strict=True))
    clean = [(value, point) for value, point in points if not point.flagged]
    if clean:
        best = min(clean, key=lambda pair: pair[1].one_step_variance)[0]
        reason = "smallest one-step variance without significant skew"
    else:
        best = min(points, key=lambda pair: pair[1].skew)[0]
        reason = "every value skews the prior significantly; this one least"
    return {
        "option": option,
        "value": best,
        "reason": reason,
        "frontier": [
            {
                "name": point.name,
                "skew": point.skew,
                "flagged": point.flagged,
                "one_step_variance": point.one_step_variance,
                "one_step_error": point.one_step_error,
                "candidates": point.candidates,
            }
            for point in found
        ],
    }


def with_choice(method: str, training: Episodes, options: Options) -> Options:
    """The options, with what the method leaves open chosen by the frontier."""
    if not is_open(method, options):
        return options
    windows = options.fitting(training).windows(training)
    chosen = choose(method, seen_by(training, options), options, windows=windows)
    return replace(options, **{chosen["option"]: chosen["value"]})


def is_open(method: str, options: Options) -> bool:
    """Whether the method has an option that is to be chosen."""
    open_ = method in _OPEN and getattr(options, _OPEN[method]) is None
    return open_ and options.asks_the_frontier(method)


def seen_by(training: Episodes, options: Options) -> Dataset:
    """The rows that a training of these options would see."""
    options = options.fitting(training)
    return options.windows(training).dataset(training, label=options.label)


def _weights(data: Dataset) -> list[float]:
    assert data.c is not None
    spread = float(data.c.var(dim=0).sum())
    ratio = (float(data.x1.var(dim=0).sum()) + data.dim) / spread if spread else 1.0
    return [factor * ratio for factor in FACTORS]


def _strata(data: Dataset) -> list[int]:
    return sorted({max(1, len(data) // rows) for rows in STRATUM_ROWS})
