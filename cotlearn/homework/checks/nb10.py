"""The checks of notebook 10."""

import math
import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.homework.checks.common import Array, Case, Cases, table
from cotlearn.homework.registry import NotYet


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


@table("10.gap", seed=10)
def gap(g: torch.Generator) -> Cases:
    """The error with shuffled noise minus that with the noise of the pairs."""
    for n in (7, 12):
        x0, noise, c = (torch.randn(n, 3, generator=g) for _ in range(3))
        x1 = 0.8 * x0 + c + 0.3 * noise
        order = torch.randperm(n, generator=g)

        def model(x0: Tensor, c: Tensor) -> Tensor:
            return x0 + 0.9 * c.sin()

        def error(x0: Tensor, c: Tensor, x1: Tensor = x1) -> Tensor:
            return (model(x0, c) - x1).square().sum(dim=1)

        coupled, fresh, both = error(x0, c), error(x0[order], c), error(x0[order], c[order])
        right = (fresh - coupled).mean()
        wrong = {
            "the other way round: fresh minus coupled": -right,
            "shuffle the noise alone: the conditions stay with their x1": (both - coupled).mean(),
            "shuffle the noise, not the conditions": (error(x0, c[order]) - coupled).mean(),
            "nothing changes: shuffle the noise, not c and x1 with it, and compare with x1": 0.0,
            "the squared distance is a sum over the columns, not a mean": right / 3,
            "take the mean over the rows, not the sum": n * right,
            "square the distances": (fresh.sqrt() - coupled.sqrt()).mean(),
        }
        yield Case((model, x0, c, x1, order), right, wrong)


@table("10.pareto")
def pareto() -> Cases:
    """The policies that no other beats in success without less variety, or the other way round."""
    rows = (
        ("a", 0.99, 0.20),
        ("b", 0.95, 1.00),
        ("c", 0.90, 1.00),
        ("d", 0.60, 1.04),
        ("e", 0.95, 0.90),
        ("f", 0.20, 0.10),
    )
    for some in (rows, rows[1:], rows[3:], (*rows, ("g", 0.95, 1.00))):
        policies = {name: (success, variety) for name, success, variety in some}
        right = _unbeaten(policies, operator.ge)
        dominated = sorted(set(policies) - set(right))
        strict = _unbeaten(policies, operator.gt)
        by_success = max(policies, key=policies.__getitem__)
        by_sum = max(policies, key=lambda name: sum(policies[name]))
        wrong = {
            "those are the beaten ones: return the others": dominated,
            "as good in one and better in the other is enough to beat a policy": strict,
            "compare success and variety, not their product or sum": [by_sum],
            "compare success and variety, not success alone": [by_success],
        }
        yield Case((policies,), right, wrong, f"expected {right}", read=_names)


def _unbeaten(policies: dict[str, Any], beats: Callable[[float, float], bool]) -> list[str]:
    """The policies that no other one beats in both scores."""
    both = {
        name: [all(map(beats, other, mine)) for other in policies.values() if other != mine]
        for name, mine in policies.items()
    }
    return sorted(name for name, beaten in both.items() if not any(beaten))


@table("10.memorises")
def memorises() -> Cases:
    """The policies whose energy score is worse at new starts by more than a factor."""
    scores = {"a": (1.30, 2.42), "b": (1.95, 1.96), "c": (2.9, 1.9), "d": (1.0, 1.15)}
    scores |= {"e": (1.0, 1.5), "f": (4.0, 5.5), "g": (0.5, 1.3)}
    names, (known, new) = np.array(list(scores)), np.array(list(scores.values())).T
    off = new - known
    for factor in (1.25, 1.5, 2.0):
        found = names[new > factor * known].tolist()
        wrong = {
            "large where it was trained is not memorising: new / known": known > factor * new,
            "compare the ratio of the two scores with the factor, not the difference": off > factor,
            "more than `factor` times does not include exactly as much": new >= factor * known,
            "return all above the factor, and use it as it is": new > 2 * known,
            "a little worse at new starts is not enough: use the factor": off > 0,
            "compare with its own score where it was trained, not with the factor": new > factor,
        }
        lists = {hint: names[chosen].tolist() for hint, chosen in wrong.items()}
        yield Case((scores, factor), found, lists, f"expected {found}", read=_names)


def _names(found: Any) -> list[str]:
    if isinstance(found, str) or not isinstance(found, Iterable):
        raise NotYet(f"return the names in a list, got {type(found).__name__}")
    return sorted(map(str, found))


def _entropy(modes: Array) -> float:
    share = np.unique(modes, return_counts=True)[1] / max(len(modes), 1)
    return float(-(share * np.log(share)).sum())
