"""The checks of notebook 03."""

from __future__ import annotations

import math

import numpy as np
import torch

from cotlearn.gaussian import bures_squared
from cotlearn.homework.checks.common import Case, Cases, cheapest, one_of_two, table


@table("03.labels_follow")
def labels_follow() -> Cases:
    """Optimal pairs of four points by brute force; the labels go with their data."""
    g = torch.Generator().manual_seed(3)
    two = "return two tensors: the data and their labels, in the order of x0"
    for _ in range(5):
        x0, x1 = torch.randn(4, 2, generator=g), 3 * torch.randn(4, 2, generator=g)
        c = torch.eye(4)
        order = cheapest(torch.cdist(x0, x1).square())
        hint = "this is the inverse permutation: row i must be the partner of x0[i]"
        wrong = {hint: x1[order.argsort()]}
        hint = "these are not the pairs with the smallest total squared distance"
        read = one_of_two(0, (4, 2), "the data", two)
        yield Case((x0, x1, c), x1[order], wrong, hint, read=read, unchanged=True)
        wrong = {"the data moved and the labels stayed: every label is now a wrong one": c}
        hint = "the labels should be permuted exactly as the data are"
        read = one_of_two(1, (4, 4), "the labels", two)
        yield Case((x0, x1, c), c[order], wrong, hint, read=read)


@table("03.augmented_cost")
def augmented_cost() -> Cases:
    """Compare with the formula entry by entry."""
    g = torch.Generator().manual_seed(4)
    x0, x1 = torch.randn(5, 2, generator=g), torch.randn(5, 2, generator=g)
    c0, c = torch.randn(5, 3, generator=g), torch.randn(5, 3, generator=g)
    far, apart = torch.cdist(x0, x1), torch.cdist(c0, c)
    for weight in (0.0, 1.0, 7.0):
        right = far**2 + weight * apart**2
        wrong = {
            "the distances must be squared": far + weight * apart,
            "the sample's distance must be squared too": far + weight * apart**2,
            "the condition's distance must be squared": far**2 + weight * apart,
            "rows belong to x0 and columns to x1": right.T,
            "the formula has w, not w squared": far**2 + weight**2 * apart**2,
            "the weight belongs to the condition only": weight * (far**2 + apart**2),
        }
        hint = f"for weight {weight:g} the entries are not those of the formula"
        yield Case((x0, c0, x1, c, weight), right, wrong, hint, "the cost")


@table("03.skew")
def skew() -> Cases:
    """Compare with the Bures distance, for a few vectors r and variances v."""
    cases = [((0.0, 0.0), 1.0), ((0.6, 0.0), 1.0), ((0.3, -0.8), 2.0), ((0.2, 0.1, 0.4), 0.5)]
    for numbers, v in cases:
        r = np.array(numbers)
        rho2 = float(r @ r) / v
        right = rho2 + bures_squared(np.eye(len(r)) - np.outer(r, r) / v, np.eye(len(r)))
        wrong = {
            "this is the part of the means; the covariance of p(x0 | c) counts too": rho2,
            "this is the part of the covariance; the mean of p(x0 | c) moves too": right - rho2,
            "divide by the variance v of c": 2 - 2 * math.sqrt(max(1 - float(r @ r), 0.0)),
        }
        yield Case((r, v), right, wrong, tolerance=1e-6)
