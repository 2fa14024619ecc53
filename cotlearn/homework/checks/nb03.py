"""The checks of notebook 03."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import torch

from cotlearn.gaussian import bures_squared
from cotlearn.homework.registry import NotYet, exercise


def _tensor(value: Any, name: str, shape: tuple[int, ...]) -> torch.Tensor:
    if not isinstance(value, torch.Tensor):
        raise NotYet(f"{name} should be a tensor, got {type(value).__name__}")
    if tuple(value.shape) != shape:
        raise NotYet(f"{name} should have shape {shape}, got {tuple(value.shape)}")
    if not value.isfinite().all():
        raise NotYet(f"{name} has NaN or infinite values")
    return value


@exercise("03.labels_follow")
def labels_follow(answer: Any) -> None:
    """Optimal pairs of four points by brute force; the labels go with their data."""
    g = torch.Generator().manual_seed(3)
    for _ in range(5):
        x0, x1 = torch.randn(4, 2, generator=g), 3 * torch.randn(4, 2, generator=g)
        c = torch.eye(4)
        inputs = (x0.clone(), x1.clone(), c.clone())
        found = answer(x0, x1, c)
        if not isinstance(found, tuple | list) or len(found) != 2:
            raise NotYet("return two tensors: the data and their labels, in the order of x0")
        data = _tensor(found[0], "the data", (4, 2))
        labels = _tensor(found[1], "the labels", (4, 4))
        if not all(torch.equal(a, b) for a, b in zip(inputs, (x0, x1, c), strict=True)):
            raise NotYet("your function changed its inputs; index them, which makes copies")
        cost = torch.cdist(x0, x1).square()
        best = min(
            itertools.permutations(range(4)),
            key=lambda p: sum(float(cost[i, j]) for i, j in enumerate(p)),
        )
        order = list(best)
        if not torch.allclose(data, x1[order]):
            if torch.allclose(data, x1[np.argsort(order)]):
                raise NotYet("this is the inverse permutation: row i must be the partner of x0[i]")
            raise NotYet("these are not the pairs with the smallest total squared distance")
        if torch.equal(labels, c) and order != [0, 1, 2, 3]:
            raise NotYet("the data moved and the labels stayed: every label is now a wrong one")
        if not torch.equal(labels, c[order]):
            raise NotYet("the labels should be permuted exactly as the data are")


@exercise("03.augmented_cost")
def augmented_cost(answer: Any) -> None:
    """Compare with the formula entry by entry."""
    g = torch.Generator().manual_seed(4)
    x0, x1 = torch.randn(5, 2, generator=g), torch.randn(5, 2, generator=g)
    c0, c = torch.randn(5, 3, generator=g), torch.randn(5, 3, generator=g)
    sample = (x0[:, None] - x1[None]).square().sum(dim=2)
    condition = (c0[:, None] - c[None]).square().sum(dim=2)
    for weight in (0.0, 1.0, 7.0):
        got = _tensor(answer(x0, c0, x1, c, weight), "the cost", (5, 5)).to(torch.float32)
        if torch.allclose(got, sample + weight * condition, atol=1e-4):
            continue
        guesses = {
            "the distances must be squared": sample.sqrt() + weight * condition.sqrt(),
            "the sample's distance must be squared too": sample.sqrt() + weight * condition,
            "the condition's distance must be squared": sample + weight * condition.sqrt(),
            "rows belong to x0 and columns to x1": (sample + weight * condition).T,
            "the formula has w, not w squared": sample + weight**2 * condition,
            "the weight belongs to the condition only": weight * (sample + condition),
        }
        for hint, wrong in guesses.items():
            if torch.allclose(got, wrong, atol=1e-4):
                raise NotYet(hint)
        raise NotYet(f"for weight {weight:g} the entries are not those of the formula")


@exercise("03.skew")
def skew(answer: Any) -> None:
    """Compare with the Bures distance, for a few vectors r and variances v."""
    cases = [((0.0, 0.0), 1.0), ((0.6, 0.0), 1.0), ((0.3, -0.8), 2.0), ((0.2, 0.1, 0.4), 0.5)]
    for numbers, v in cases:
        r = np.array(numbers)
        try:
            got = float(answer(r, v))
        except (TypeError, ValueError):
            raise NotYet("return one number") from None
        rho2 = float(r @ r) / v
        covariance = np.eye(len(r)) - np.outer(r, r) / v
        expected = rho2 + bures_squared(covariance, np.eye(len(r)))
        if math.isclose(got, expected, abs_tol=1e-6):
            continue
        if math.isclose(got, rho2, abs_tol=1e-6):
            raise NotYet("this is the part of the means; the covariance of p(x0 | c) counts too")
        if math.isclose(got, expected - rho2, abs_tol=1e-6):
            raise NotYet("this is the part of the covariance; the mean of p(x0 | c) moves too")
        if v != 1 and math.isclose(
            got, 2 - 2 * math.sqrt(max(1 - float(r @ r), 0.0)), abs_tol=1e-6
        ):
            raise NotYet("divide by the variance v of c")
        raise NotYet(f"for r = {r.tolist()} and v = {v} expected {expected:.4f}, got {got:.4f}")
