"""The checks of notebook 10."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from cotlearn.homework.checks.common import Array, compare, expect_function, number
from cotlearn.homework.registry import NotYet, exercise


@exercise("10.ways_entropy")
def ways_entropy(answer: Any) -> None:
    """The entropy of the ways that succeeded, averaged over starts."""
    expect_function(answer)
    for rows in (
        [[0, 1, 2, 0, 1, 2], [0, 0, 0, 0, 1, 2]],
        [[0, 0, 0, 0], [0, 1, 0, 1], [2, 2, 1, 2]],
        [[0, -1, 1, 2], [-1, -1, 1, 1], [0, 2, 0, -1]],
        [[-1, -1, -1], [0, 0, 1], [0, 2, 1]],
    ):
        modes = np.array(rows)
        value = number(answer(modes.copy()))
        if np.isnan(value):
            raise NotYet("it is nan: leave out ways that were not taken; 0 log 0 counts as 0")
        each = [_entropy(row[row >= 0]) for row in modes]
        some = [_entropy(row[row >= 0]) for row in modes if (row >= 0).any()]
        right = float(np.mean(each))
        compare(
            value,
            right,
            (
                (-right, "the entropy has a minus sign: -sum p log p"),
                (right / np.log(2), "in nats, so with np.log and not np.log2"),
                (np.exp(right), "that is a perplexity: leave out exp"),
                (right / np.log(3), "not normalised here: the demonstrator's comes out below"),
                (float(np.mean([_entropy(row) for row in modes])), "-1 is a failure, not a way"),
                (_entropy(modes[modes >= 0]), "first start by start, then the mean over starts"),
                (float(np.mean(some)), "a start without any success counts, with entropy 0"),
                (float(np.sum(each)), "the mean over starts, not the sum"),
            ),
            f"for {rows} expected {right:.4g}, got {value:.4g}",
        )


@exercise("10.choose")
def choose(answer: Any) -> None:
    """The smallest one-step variance without significant skew, or else the least skew."""
    expect_function(answer)
    for rows in (
        [("a", 0.0, False, 16.0), ("b", 0.1, True, 13.0), ("c", 0.01, False, 14.0)],
        [("a", 0.005, False, 11.0), ("b", 0.002, False, 12.0), ("c", 0.2, True, 9.0)],
        [("a", 0.3, True, 3.0), ("b", 0.1, True, 5.0), ("c", 0.2, True, 9.0)],
    ):
        names = ("name", "skew", "flagged", "one_step_variance")
        points = [SimpleNamespace(**dict(zip(names, row, strict=True))) for row in rows]
        clean = [point for point in points if not point.flagged]
        least = min(points, key=lambda point: point.skew).name
        right = min(clean, key=lambda point: point.one_step_variance).name if clean else least
        found = answer(list(points))
        found = getattr(found, "name", found)  # the point itself will do
        if found == right:
            continue
        if not clean:
            raise NotYet("if all are flagged, take the one with the least skew")
        if found == min(points, key=lambda point: point.one_step_variance).name:
            raise NotYet("that one is flagged: leave those out first")
        if found == least:
            raise NotYet("without a flag it is the one-step variance that counts, not the skew")
        raise NotYet(f"from {rows} expected {right!r}, got {found!r}")


def _entropy(ways: Array | Any) -> float:
    if len(ways) == 0:
        return 0.0
    share = np.unique(ways, return_counts=True)[1] / len(ways)
    return float(-(share * np.log(share)).sum())
