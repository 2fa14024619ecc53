"""The checks of notebook 03 and of its laboratory."""

import math
from typing import Any

import numpy as np
import torch

from cotlearn.gaussian import bures_squared

from .common import Case, Cases, cheapest, one_of_two, table


@table("03.labels_follow", seed=3)
def labels_follow(g: torch.Generator) -> Cases:
    """Optimal pairs of four points, found by brute force; labels stay with their data."""
    two = "return two tensors: the data and their labels, in the order of x0"
    for _ in range(5):
        x0, x1 = torch.randn(4, 2, generator=g), 3 * torch.randn(4, 2, generator=g)
        c = torch.eye(4)
        order = cheapest(torch.cdist(x0, x1).square())
        inverse = x1[order.argsort()]
        wrong = {"this is the inverse permutation: row i must be the partner of x0[i]": inverse}
        hint = "these are not the pairs with the smallest total squared distance"
        read = one_of_two(0, (4, 2), "the data", two)
        yield Case((x0, x1, c), x1[order], wrong, hint, read=read)
        wrong = {"the data moved and the labels stayed: every label is now a wrong one": c}
        hint = "the labels should be permuted exactly as the data are"
        read = one_of_two(1, (4, 4), "the labels", two)
        yield Case((x0, x1, c), c[order], wrong, hint, read=read)


@table("03.augmented_cost", seed=4)
def augmented_cost(g: torch.Generator) -> Cases:
    """The cost matrix, compared entry by entry."""
    x0, x1 = torch.randn(5, 2, generator=g), torch.randn(5, 2, generator=g)
    c0, c = torch.randn(5, 3, generator=g), torch.randn(5, 3, generator=g)
    for weight in (0.0, 1.0, 7.0):
        yield costs((x0, c0, x1, c, weight), torch.cdist(x0, x1), torch.cdist(c0, c), weight)


def costs(given: tuple[Any, ...], far: torch.Tensor, apart: torch.Tensor, w: float) -> Case:
    """A case for far² + w apart², the cost (n, m) of distances in samples and conditions."""
    right = far**2 + w * apart**2
    wrong = {
        "square the distances": far + w * apart,
        "square the distance of x0 and x1, too": far + w * apart**2,
        "square the distance of the conditions, too": far**2 + w * apart,
        "the weight itself is not squared": far**2 + w**2 * apart**2,
        "the conditions do not count yet: add weight times their squared distance": far**2,
        "only the conditions count; add the distance of x0 and x1": w * apart**2,
        "the weight belongs to the conditions": w * far**2 + apart**2,
        "the weight belongs to the conditions alone": w * (far**2 + apart**2),
        "no root: the cost is a sum of squares": right.sqrt(),
        "rows belong to x0 and columns to x1": right.T,
    }
    hint = f"with weight {w:g} entry i, j is |x0_i - x1_j|² + {w:g} |c0_i - c1_j|²"
    return Case(given, right, wrong, hint, "the cost")


@table("03.skew")
def skew() -> Cases:
    """The skew, compared with the Bures distance for several vectors r and variances v."""
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


@table("03.energy_distance", seed=5)
def energy_distance(g: torch.Generator) -> Cases:
    """The unbiased energy distance between samples of different sizes and of the same law."""
    for n, m, off in ((3, 5, 1), (6, 4, 0)):
        x, y = torch.randn(n, 2, generator=g), off + 2**off * torch.randn(m, 2, generator=g)
        far, in_x, in_y = (torch.cdist(*two).mean() for two in ((x, y), (x, x), (y, y)))
        apart_x, apart_y = in_x * n / (n - 1), in_y * m / (m - 1)
        wrong = {
            "a row and itself are no pair: divide by n (n - 1), m (m - 1)": 2 * far - in_x - in_y,
            "the distances between the samples count twice": far - apart_x - apart_y,
            "take away the distances within both samples": 2 * far,
            "an estimate of 0 without bias is often negative: do not cut it off at 0": 0.0,
            "this has the wrong sign": apart_x + apart_y - 2 * far,
        }
        yield Case((x, y), 2 * far - apart_x - apart_y, wrong)
