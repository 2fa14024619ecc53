"""The checks of notebook 02."""

from __future__ import annotations

import itertools
import math
from typing import Any

import torch
from torch import Tensor

from cotlearn.homework.checks.common import expect_function
from cotlearn.homework.registry import NotYet, exercise


@exercise("02.transport_cost")
def transport_cost(answer: Any) -> None:
    """The mean squared distance of a pairing."""
    expect_function(answer)
    x0, x1 = _points(6, 3, seed=0)
    p = torch.tensor([2, 0, 1, 5, 3, 4])
    value = _number(answer(x0.clone(), x1.clone(), p.clone()))
    off = x0 - x1[p]
    squares = off.square()
    hints = [
        (squares.sum(), "this is the total; take the mean over the pairs"),
        (squares.mean(), "take the mean over pairs, but the sum over coordinates"),
        (off.norm(dim=1).mean(), "these are distances; the cost is their square"),
        (off.norm(dim=1).mean() ** 2, "square each distance first, then take the mean"),
        ((x0 - x1).square().sum(dim=1).mean(), "p is not used: x0[i] meets x1[p[i]]"),
        ((x0[p] - x1).square().sum(dim=1).mean(), "p belongs to x1: x0[i] meets x1[p[i]]"),
        ((x0[p] - x1[p]).square().sum(dim=1).mean(), "only x1 is permuted; x0 stays in order"),
        (torch.cdist(x0, x1).square().mean(), "this averages over all pairs, not over those of p"),
    ]
    for wrong, hint in hints:
        if math.isclose(value, float(wrong), rel_tol=1e-4):
            raise NotYet(hint)
    right = float(squares.sum(dim=1).mean())
    if not math.isclose(value, right, rel_tol=1e-4):
        raise NotYet(f"for one small batch expected {right:.4f}, got {value:.4f}")


@exercise("02.cheapest_pairing")
def cheapest_pairing(answer: Any) -> None:
    """The optimal permutation, against all permutations of a few points."""
    expect_function(answer)
    for seed in range(12):
        x0, x1 = _points(5, 2, seed=seed)
        p = _permutation(answer(x0.clone(), x1.clone()), len(x0))
        cost = torch.cdist(x0, x1).square()
        best = _cheapest(cost)
        if torch.equal(p, best):
            continue
        if torch.equal(p, best.argsort()):
            raise NotYet("this is the inverse: p[i] is the data point of noise point i")
        if torch.equal(p, _cheapest(-cost)):
            raise NotYet("this is the dearest pairing, not the cheapest")
        if torch.equal(p, _cheapest(cost.sqrt())):
            raise NotYet("you minimised distances; the cost is the squared distance")
        if torch.equal(p, _greedy(cost)):
            raise NotYet(
                "taking the nearest free point, one after the other, is greedy: "
                "early pairs take partners that later ones need more"
            )
        rows = torch.arange(len(x0))
        raise NotYet(
            f"on five points your pairing costs {cost[rows, p].mean():.4f}, "
            f"the best one {cost[rows, best].mean():.4f}"
        )


@exercise("02.lost_share")
def lost_share(answer: Any) -> None:
    """(1 - 1/B)^B."""
    expect_function(answer)
    for size in (5, 2, 256):  # at 2 several mistakes look alike
        value = _number(answer(size))
        missed = (1 - 1 / size) ** size
        hints = [
            (1 / math.e, "this is the limit for large B; a batch of 2 loses 1/4 on average"),
            (1 - 1 / math.e, "this is what is kept, for large B; what is lost?"),
            (1 - missed, "this is the share that is drawn; what is left out?"),
            (1 - 1 / size, "this is the chance to be missed by one draw; there are B of them"),
            (1 / size, "this is the chance to be hit by one draw"),
            (size * missed, "this is the number of points; divide by B"),
            (1 / size**size, "one draw misses a point with probability 1 - 1/B"),
        ]
        for wrong, hint in hints:
            if not math.isclose(wrong, missed, rel_tol=1e-6) and _near(value, wrong):
                raise NotYet(hint)
        if not _near(value, missed):
            raise NotYet("with what probability do all B draws miss a certain point?")


def _points(n: int, d: int, *, seed: int) -> tuple[Tensor, Tensor]:
    g = torch.Generator().manual_seed(seed)
    return torch.randn(n, d, generator=g), 2 * torch.randn(n, d, generator=g) + 1


def _permutation(value: Any, n: int) -> Tensor:
    if isinstance(value, tuple) and len(value) == 2:
        raise NotYet("return only the columns; linear_sum_assignment gives rows and columns")
    try:
        p = torch.as_tensor(value)
    except (TypeError, ValueError, RuntimeError):
        raise NotYet(f"return {n} integers, got {type(value).__name__}") from None
    if p.shape != (n,):
        raise NotYet(f"return {n} integers, one for each noise point, got shape {tuple(p.shape)}")
    if p.is_floating_point() or sorted(p.tolist()) != list(range(n)):
        raise NotYet(
            f"{p.tolist()} is not a permutation: each data point must come exactly once"
            " (the nearest point of each would take some twice)"
        )
    return p.long()


def _cheapest(cost: Tensor) -> Tensor:
    """The best of all permutations, one by one."""
    everyone = torch.tensor(list(itertools.permutations(range(len(cost)))))
    totals = cost[torch.arange(len(cost)), everyone].sum(dim=1)
    return everyone[totals.argmin()]


def _greedy(cost: Tensor) -> Tensor:
    free = cost.clone()
    p = []
    for row in free:
        j = int(row.argmin())
        p.append(j)
        free[:, j] = math.inf
    return torch.tensor(p)


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError, RuntimeError):
        got = f"shape {tuple(value.shape)}" if isinstance(value, Tensor) else type(value).__name__
        raise NotYet(f"return one number, got {got}") from None


def _near(value: float, expected: float) -> bool:
    return math.isclose(value, expected, rel_tol=1e-3, abs_tol=1e-6)
