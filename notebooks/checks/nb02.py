"""The checks of notebook 02."""

import math
from typing import Any

import torch

from cotlearn.course.checking import NotYet

from .common import Case, Cases, cheapest, permutation, squares, table


@table("02.transport_cost")
def transport_cost(g: torch.Generator) -> Cases:
    """The mean squared distance between the two points of a pair."""
    for n, d in ((6, 3), (9, 2)):
        x0, x1 = torch.randn(2, n, d, generator=g)
        p = torch.randperm(n, generator=g)
        off, far = x0 - x1[p], torch.cdist(x0, x1).square()
        wrong = squares(off) | {
            "p is not used, or on both sides: x0[i] meets x1[p[i]]": far.diagonal().mean(),
            "p belongs to x1: x0[i] meets x1[p[i]]": far[p, range(n)].mean(),
            "this averages over all pairs, not over those of p": far.mean(),
        }
        yield Case((x0, x1, p), off.square().sum(dim=1).mean(), wrong)


@table("02.cheapest_pairing")
def cheapest_pairing(g: torch.Generator) -> Cases:
    """The permutation that pairs a few points at the smallest total cost."""
    for _ in range(12):
        yield _pairing(torch.randn(5, 2, generator=g), 2 * torch.randn(5, 2, generator=g) + 1)


def _pairing(x0: torch.Tensor, x1: torch.Tensor) -> Case:
    def read(value: Any) -> torch.Tensor:
        if isinstance(value, tuple) and len(value) == 2:
            raise NotYet("return only the columns; linear_sum_assignment gives rows and columns")
        hint = "each data point must come exactly once (the nearest of each would repeat some)"
        return permutation(value, len(x0), hint)

    def otherwise(p: torch.Tensor) -> str:
        rows = torch.arange(len(p))
        yours, least = cost[rows, p].mean(), cost[rows, best].mean()
        return f"on five points your pairing costs {yours:.4f}, the best one {least:.4f}"

    cost = torch.cdist(x0, x1).square()
    best = cheapest(cost)
    wrong = {
        "this is the inverse: p[i] is the data point of noise point i": best.argsort(),
        "this is the most expensive pairing, not the cheapest": cheapest(-cost),
        "you minimised distances; the cost is the squared distance": cheapest(cost.sqrt()),
        "the nearest free point, one by one, is greedy: later pairs may need it": _greedy(cost),
    }
    return Case((x0, x1), best, wrong, otherwise, read=read)


@table("02.lost_share")
def lost_share() -> Cases:
    """The expected share of rows that B draws with replacement miss, (1 - 1/B)^B."""
    for size in (5, 2, 256):  # at 2 several mistakes look alike
        missed = (1 - 1 / size) ** size
        wrong = {
            "this is the limit for large B; a batch of 2 loses 1/4 on average": 1 / math.e,
            "this is what is kept, for large B; what is lost?": 1 - 1 / math.e,
            "this is the share that is drawn; what is left out?": 1 - missed,
            "this is the chance to be missed by one draw; there are B of them": 1 - 1 / size,
            "this is the chance to be hit by one draw": 1 / size,
            "this is the number of points; divide by B": size * missed,
            "one draw misses a point with probability 1 - 1/B": 1 / size**size,
        }
        hint = "with what probability do all B draws miss a certain point?"
        yield Case((size,), missed, wrong, hint, tolerance=5e-4)


def _greedy(cost: torch.Tensor) -> torch.Tensor:
    free = cost.clone()
    p = []
    for row in free:
        p.append(int(row.argmin()))
        free[:, p[-1]] = math.inf
    return torch.tensor(p)
