"""The checks of notebook 10."""

import math
import operator
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.course.checking import NotYet

from .common import Array, Case, Cases, table

FOLDS = 5  #: of cross-fitting
#: Success and variety of each policy.
Scores = dict[str, tuple[float, float]]


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
        each = np.array([_entropy(row[row >= 0]) for row in modes])
        with_success = each[(modes >= 0).any(axis=1)]
        with_failures = np.array([_entropy(row) for row in modes])
        right = each.mean()
        wrong = {
            "it is nan: leave out modes that do not occur; 0 log 0 counts as 0": math.isnan,
            "the entropy has a minus sign: -sum p log p": -right,
            "in nats, so with np.log and not np.log2": right / np.log(2),
            "that is a perplexity: leave out exp": np.exp(right),
            "not normalised here: compare with the demonstrator's entropy below": right / np.log(3),
            "-1 is a failure, not a mode": with_failures.mean(),
            "first start by start, then the mean over starts": _entropy(modes[modes >= 0]),
            "a start without any success counts, with entropy 0": with_success.mean(),
            "the mean over starts, not the sum": each.sum(),
        }
        yield Case((modes,), right, wrong)


def _entropy(modes: Array) -> float:
    share = np.unique(modes, return_counts=True)[1] / max(len(modes), 1)
    return float(-(share * np.log(share)).sum())


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

        coupled = error(x0, c)
        fresh = error(x0[order], c)
        other_conditions = error(x0, c[order])
        both = error(x0[order], c[order])
        distances = fresh.sqrt() - coupled.sqrt()
        right = (fresh - coupled).mean()
        wrong = {
            "the other way round: fresh minus coupled": -right,
            "shuffle the noise alone: the conditions stay with their x1": (both - coupled).mean(),
            "shuffle the noise, not the conditions": (other_conditions - coupled).mean(),
            "nothing changes: shuffle the noise, not c and x1 with it, and compare with x1": 0.0,
            "the squared distance is a sum over the columns, not a mean": right / 3,
            "take the mean over the rows, not the sum": n * right,
            "square the distances": distances.mean(),
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
    twin = ("g", 0.95, 1.00)
    for some in (rows, rows[1:], rows[3:], (*rows, twin)):
        policies = {name: (success, variety) for name, success, variety in some}
        right = _unbeaten(policies, operator.ge)
        strict = _unbeaten(policies, operator.gt)
        wrong = {
            "those are the beaten ones: return the others": sorted(set(policies) - set(right)),
            "as good in one and better in the other is enough to beat a policy": strict,
            "compare success and variety, not their product or sum": [_best(policies, sum)],
            "compare success and variety, not success alone": [_best(policies, tuple)],
        }
        yield Case((policies,), right, wrong, f"expected {right}", read=_names)


def _unbeaten(policies: Scores, beats: Callable[[float, float], bool]) -> list[str]:
    """The policies that no other one beats in both scores; equal scores beat nobody."""

    def beaten(mine: tuple[float, float]) -> bool:
        others = [scores for scores in policies.values() if scores != mine]
        return any(all(map(beats, scores, mine)) for scores in others)

    return sorted(name for name, scores in policies.items() if not beaten(scores))


def _best(policies: Scores, score: Callable[[tuple[float, float]], Any]) -> str:
    return max(policies, key=lambda name: score(policies[name]))


@table("10.memorises")
def memorises() -> Cases:
    """The policies whose energy score is worse at new starts by more than a factor."""
    scores = {
        "a": (1.30, 2.42),
        "b": (1.95, 1.96),
        "c": (2.9, 1.9),
        "d": (1.0, 1.15),
        "e": (1.0, 1.5),
        "f": (4.0, 5.5),
        "g": (0.5, 1.3),
    }
    names = np.array(list(scores))
    known, new = np.array(list(scores.values())).T
    off = new - known
    for factor in (1.25, 1.5, 2.0):
        right = names[new > factor * known].tolist()
        chosen = {
            "large where it was trained is not memorising: new / known": known > factor * new,
            "compare the ratio of the two scores with the factor, not the difference": off > factor,
            "more than `factor` times does not include exactly as much": new >= factor * known,
            "return all above the factor, and use it as it is": new > 2 * known,
            "a little worse at new starts is not enough: use the factor": new > known,
            "compare with its own score where it was trained, not with the factor": new > factor,
        }
        wrong = {hint: names[rows].tolist() for hint, rows in chosen.items()}
        yield Case((scores, factor), right, wrong, f"expected {right}", read=_names)


def _names(found: Any) -> list[str]:
    if isinstance(found, str) or not isinstance(found, Iterable):
        raise NotYet(f"return the names in a list, got {type(found).__name__}")
    return sorted(map(str, found))


@table("10.cross_fit")
def cross_fit(g: torch.Generator) -> Cases:
    """The mean of each window from a fit that never saw its episode, in five folds."""
    for lengths in ((3, 1, 4, 2, 5, 3, 2), (2, 2, 6, 1, 3, 4, 1, 2, 3, 5, 2)):
        episode = torch.repeat_interleave(torch.tensor(lengths))
        x1 = torch.randn(len(episode), 3, generator=g)
        weights = torch.rand(len(episode), len(episode), generator=g)

        def fit(rows: Tensor, x1: Tensor = x1, weights: Tensor = weights) -> Tensor:
            near = weights * rows
            return near @ x1 / near.sum(dim=1, keepdim=True)

        everywhere = fit(torch.ones_like(episode, dtype=torch.bool))
        alone = _folded(lambda rows: fit(~rows), episode % FOLDS)
        folds = torch.stack([fit(episode % FOLDS != k) for k in range(FOLDS)])
        by_window = _folded(fit, torch.arange(len(episode)) % FOLDS)
        wrong = {
            "those fits saw the window's own episode: leave its fold out": everywhere,
            "that fits on the fold alone: fit on all rows but those of the fold": alone,
            "those folds are of windows, so a fit saw others of the same episode": by_window,
            "take the one fit that left the window's fold out, not the mean of five": folds.mean(0),
        }
        yield Case((episode, fit), _folded(fit, episode % FOLDS), wrong)


def _folded(fit: Callable[[Tensor], Tensor], fold: Tensor) -> Tensor:
    """For each row the prediction of the fit without its fold."""
    found = [fit(fold != k) for k in range(FOLDS)]
    return torch.stack(found)[fold, torch.arange(len(fold))]
