"""What the frontier chooses before any training: COT's condition weight, the number of strata."""

from dataclasses import replace
from typing import Any

from cotlearn.couplings import Coupling, Independent
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.options import Options
from cotlearn.robots.episodes import Episodes

#: condition weights, as multiples of the ratio of sample to condition variance
FACTORS = (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
STRATUM_ROWS = (10, 20, 40, 80, 160, 320)  #: rows of a stratum, on average
FRONTIER_ROWS = 4096  #: pairs that are looked at for each value
_COLUMNS = ("name", "skew", "flagged", "one_step_variance", "one_step_error", "candidates")


def choose(method: str | Method, training: Episodes, options: Options) -> dict[str, Any] | None:
    """Chooses the open option of a method, without any training or rollout.

    It is the value with the smallest one-step variance whose prior skew is not significant; if all
    are, the least skewed one. (The predicted one-step error, which weighs both in few dimensions,
    says little about chunks: in dozens of dimensions no pair has near neighbours, and it is least
    for independent pairs.)

    Args:
        method: whose option is open; one with `prepare` is looked at as it is before.
        training: episodes that the training would see.
        options: of the training.

    Returns:
        "option", "value", "reason", and the points of the "frontier"; None: no option is open.
    """
    method = find_method(method)
    option = method.open_option
    if not option or getattr(options, option) is not None:
        return None
    windows = options.windows(training)
    data = windows.dataset(training, label=options.label)
    assert data.c is not None
    values: list[Any]
    if option == "clusters":
        values = sorted({max(1, len(data) // rows) for rows in STRATUM_ROWS})
    else:
        spread = float(data.c.var(dim=0).sum())
        ratio = (float(data.x1.var(dim=0).sum()) + data.dim) / spread if spread else 1.0
        values = [factor * ratio for factor in FACTORS]
    couplings: dict[str, Coupling] = {"independent": Independent()}
    pictures = None
    for value in values:
        tried = replace(options, **{option: value})
        if pictures is None or option == "clusters":
            pictures = method.fitted_pictures(tried, data, windows)
        couplings[f"{value:g}"] = method.coupling(tried, pictures)
    found = frontier(
        data.x1, data.c, couplings, batch_size=options.ot_batch_size, rows=FRONTIER_ROWS
    )
    points = list(zip(values, list(found)[1:], strict=True))
    clean = [pair for pair in points if not pair[1].flagged]
    if clean:
        best, _ = min(clean, key=lambda pair: pair[1].one_step_variance)
        reason = "smallest one-step variance without significant skew"
    else:
        best, _ = min(points, key=lambda pair: pair[1].skew)
        reason = "every value skews the prior significantly; this one least"
    return {
        "option": option,
        "value": best,
        "reason": reason,
        "frontier": [{name: getattr(point, name) for name in _COLUMNS} for point in found],
    }


def with_choice(method: str | Method, training: Episodes, options: Options) -> Options:
    """The options, with what the method leaves open chosen by the frontier."""
    chosen = choose(method, training, options)
    return replace(options, **{chosen["option"]: chosen["value"]}) if chosen else options


def seen_by(training: Episodes, options: Options) -> Dataset:
    """The rows that a training of these options would see."""
    return options.windows(training).dataset(training, label=options.label)
