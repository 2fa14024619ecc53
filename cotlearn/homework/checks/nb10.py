"""The checks of notebook 10."""

import math
from dataclasses import replace

import numpy as np

from cotlearn.homework.checks.common import Array, Case, Cases, table
from cotlearn.homework.checks.nb08 import chosen


@table("10.ways_entropy")
def ways_entropy() -> Cases:
    """The entropy of the modes of successful rollouts, averaged over starts."""
    for rows in (
        [[0, 1, 2, 0, 1, 2], [0, 0, 0, 0, 1, 2]],
        [[0, 0, 0, 0], [0, 1, 0, 1], [2, 2, 1, 2]],
        [[0, -1, 1, 2], [-1, -1, 1, 1], [0, 2, 0, -1]],
        [[-1, -1, -1], [0, 0, 1], [0, 2, 1]],
    ):
        modes = np.array(rows)
        each = [_entropy(row[row >= 0]) for row in modes]
        some = [_entropy(row[row >= 0]) for row in modes if (row >= 0).any()]
        with_failures = np.mean([_entropy(row) for row in modes])
        right = np.mean(each)
        wrong = {
            "it is nan: leave out modes that do not occur; 0 log 0 counts as 0": math.isnan,
            "the entropy has a minus sign: -sum p log p": -right,
            "in nats, so with np.log and not np.log2": right / np.log(2),
            "that is a perplexity: leave out exp": np.exp(right),
            "not normalised here: compare with the demonstrator's entropy below": right / np.log(3),
            "-1 is a failure, not a mode": with_failures,
            "first start by start, then the mean over starts": _entropy(modes[modes >= 0]),
            "a start without any success counts, with entropy 0": np.mean(some),
            "the mean over starts, not the sum": np.sum(each),
        }
        yield Case((modes,), right, wrong)


@table("10.choose")
def choose() -> Cases:
    """The same as 08.choose, except that the point itself also counts as correct."""
    for case in (
        chosen(("a", 0.0, False, 16.0), ("b", 0.1, True, 13.0), ("c", 0.01, False, 14.0)),
        chosen(("a", 0.005, False, 11.0), ("b", 0.002, False, 12.0), ("c", 0.2, True, 9.0)),
        chosen(("a", 0.3, True, 3.0), ("b", 0.1, True, 5.0), ("c", 0.2, True, 9.0)),
    ):
        yield replace(case, read=lambda found: getattr(found, "name", found))


def _entropy(modes: Array) -> float:
    share = np.unique(modes, return_counts=True)[1] / max(len(modes), 1)
    return float(-(share * np.log(share)).sum())
