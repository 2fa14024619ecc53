"""The checks of notebook 05."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from cotlearn.homework.checks.common import expect_function, number
from cotlearn.homework.registry import NotYet, exercise


@exercise("05.pair_weights")
def pair_weights(answer: Any) -> None:
    """floor(B p) rows with the lowest error weigh 1 + boost, then the mean is 1."""
    expect_function(answer)
    g = torch.Generator().manual_seed(5)
    for rows, fraction, boost in ((10, 0.4, 0.5), (7, 0.5, 1.0), (6, 1.0, 0.5)):
        errors = torch.rand(rows, generator=g) + 0.1
        given = errors.clone()
        weights = _vector(answer(errors, fraction, boost), rows)
        if not torch.equal(errors, given):
            raise NotYet("your function changed the errors; work on a copy")
        chosen = math.floor(rows * fraction)
        raised = torch.ones(rows)
        raised[given.argsort()[:chosen]] += boost
        right = raised / raised.mean()
        if torch.allclose(weights, right, atol=1e-5):
            continue
        hardest = torch.ones(rows)
        hardest[given.argsort(descending=True)[:chosen]] += boost
        only = (raised > 1).float()
        for wrong, hint in (
            (raised, "divide by the mean, or the loss grows: that is a larger learning rate"),
            (hardest / hardest.mean(), "you raised the pairs with the highest error"),
            (only / only.mean(), "that is top-k; here the others keep weight 1"),
            (raised / raised.sum(), "the weights should have mean 1, not sum 1"),
        ):
            if torch.allclose(weights, wrong, atol=1e-5):
                raise NotYet(hint)
        more = torch.ones(rows)
        more[given.argsort()[: chosen + 1]] += boost
        if torch.allclose(weights, more / more.mean(), atol=1e-5):
            raise NotYet("one too many: floor(B p) pairs are raised")
        raise NotYet(
            f"for errors {[round(e, 2) for e in given.tolist()]}, p = {fraction} and boost {boost} "
            f"expected {[round(w, 2) for w in right.tolist()]}, "
            f"got {[round(w, 2) for w in weights.tolist()]}"
        )


@exercise("05.evaluations")
def evaluations(answer: Any) -> None:
    """B rows at t = 1, and B for each distinct condition at t = 0."""
    expect_function(answer)
    for rows, conditions in ((64, 4), (64, 1), (256, 10), (64, 64)):
        value = number(answer(rows, conditions))
        right = rows * (1 + conditions)
        hints = [
            (2 * rows**2, "that is one pair at a time; many of these evaluations are the same"),
            (rows**2, "that is one pair at a time; many of these evaluations are the same"),
            (2 * rows, "at t = 0 the network sees x0 and c_j: once for each distinct condition"),
            (2 * rows * conditions, "at t = 1 the network sees x1_j with its own c_j: B rows only"),
            (rows * conditions, "this is t = 0 alone; add t = 1"),
            (rows, "this is t = 1 alone; add t = 0"),
        ]
        for wrong, hint in hints:
            if wrong != right and value == wrong:
                raise NotYet(hint)
        if value != right:
            raise NotYet(f"for B = {rows} and {conditions} distinct conditions: {right}")


@exercise("05.at_zero")
def at_zero(answer: Any) -> None:
    """The table of an untrained network that says 0 everywhere is the squared distance."""
    expect_function(answer)
    g = torch.Generator().manual_seed(6)
    x0, x1 = torch.randn(5, 3, generator=g), 2 * torch.randn(5, 3, generator=g)
    table = answer(x0.clone(), x1.clone())
    if not isinstance(table, Tensor) or table.shape != (5, 5):
        got = tuple(table.shape) if isinstance(table, Tensor) else type(table).__name__
        raise NotYet(f"return a tensor of shape (5, 5) for five rows each, got {got}")
    right = torch.cdist(x0, x1).square()
    for wrong, hint in (
        (right.T, "this is transposed: row i belongs to x0_i"),
        (right.sqrt(), "the error is squared"),
        (2 * right, "the mean over the two times, not their sum"),
        (right / 3, "the sum over the coordinates, not their mean"),
        (right / 2, "both times contribute; their mean is not halved again"),
    ):
        if torch.allclose(table, wrong, rtol=1e-3, atol=1e-4):
            raise NotYet(hint)
    if not torch.allclose(table, right, rtol=1e-3, atol=1e-4):
        raise NotYet("put v = 0 into |v - (x1_j - x0_i)|^2: what is left, at either time?")


def _vector(value: Any, rows: int) -> Tensor:
    if not isinstance(value, Tensor) or value.shape != (rows,):
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise NotYet(f"return a tensor of shape ({rows},), got {got}")
    if not value.isfinite().all():
        raise NotYet("the weights have NaN or infinite values")
    return value.float()
