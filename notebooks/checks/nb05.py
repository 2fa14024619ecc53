"""The checks of notebook 05."""

import math

import torch

from .common import Case, Cases, table


@table("05.pair_weights", seed=5)
def pair_weights(g: torch.Generator) -> Cases:
    """Weights: 1 + boost for the floor(B p) rows of lowest error, 1 for others, mean 1."""
    for rows, fraction, boost in ((10, 0.4, 0.5), (7, 0.5, 1.0), (6, 1.0, 0.5)):
        yield _weights(torch.rand(rows, generator=g) + 0.1, fraction, boost)


def _weights(errors: torch.Tensor, fraction: float, boost: float) -> Case:
    def raised(order: torch.Tensor, count: int) -> torch.Tensor:
        weights = torch.ones(len(order))
        weights[order[:count]] += boost
        return weights

    chosen = math.floor(len(errors) * fraction)
    best, worst = (raised(errors.argsort(descending=down), chosen) for down in (False, True))
    only = (best > 1).float()
    more = raised(errors.argsort(), chosen + 1)
    right = best / best.mean()
    wrong = {
        "divide by the mean, or the loss grows: that is a larger learning rate": best,
        "you raised the pairs with the highest error": worst / worst.mean(),
        "that is top-k; here the others keep weight 1": only / only.mean(),
        "the weights should have mean 1, not sum 1": best / best.sum(),
        "one too many: floor(B p) pairs are raised": more / more.mean(),
    }
    return Case((errors, fraction, boost), right, wrong, what="the weights")


@table("05.evaluations")
def evaluations() -> Cases:
    """The number of evaluations: B rows at t = 1, and B per distinct condition at t = 0."""
    single = "that is one pair at a time; many of these evaluations are the same"
    for B, K in ((64, 4), (64, 1), (256, 10), (64, 64)):
        wrong = {
            single: lambda found, B=B: found in (B**2, 2 * B**2),
            "at t = 0 the network sees x0 and c_j: once for each distinct condition": 2 * B,
            "at t = 1 the network sees x1_j with its own c_j: B rows only": 2 * B * K,
            "this is t = 0 alone; add t = 1": B * K,
            "this is t = 1 alone; add t = 0": B,
        }
        yield Case((B, K), B * (1 + K), wrong, tolerance=0)


@table("05.at_zero", seed=6)
def at_zero(g: torch.Generator) -> Cases:
    """The error table of a network that returns 0 everywhere: squared distances."""
    x0, x1 = torch.randn(5, 3, generator=g), 2 * torch.randn(5, 3, generator=g)
    right = torch.cdist(x0, x1).square()
    wrong = {
        "this is transposed: row i belongs to x0_i": right.T,
        "the error is squared": right.sqrt(),
        "the mean over the two times, not their sum": 2 * right,
        "the sum over the coordinates, not their mean": right / 3,
        "both times contribute; their mean is not halved again": right / 2,
    }
    hint = "put v = 0 into |v - (x1_j - x0_i)|^2: what is left, at either time?"
    yield Case((x0, x1), right, wrong, hint, "the table", tolerance=1e-3)
