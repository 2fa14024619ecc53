"""The checks of homework 3: optimal vector fields."""

from dataclasses import replace

import torch

from .common import Case, Cases, learnable, squares, table
from .nb06 import line_start


@table("hw3.gaussian_map")
def gaussian_map(g: torch.Generator) -> Cases:
    """The optimal map from N(0, I) to N(m, S): m + S^(1/2) x."""
    root = torch.tensor([[1.2, 0.5], [0.5, 0.6]]) + 0.1 * torch.rand(1, generator=g)
    mean, x = torch.tensor([2.0, -1.0]), torch.randn(6, 2, generator=g)
    cov = root @ root
    lower, inverse, entries = torch.linalg.cholesky(cov), torch.linalg.inv(root), cov.abs().sqrt()
    wrong = {
        "that has the right law, but Cholesky's map turns the points: the optimal one is the "
        "symmetric root": mean + x @ lower.T,
        "that has another law, and is not symmetric: take the root by eigh": mean + x @ lower,
        "that is S x; the covariance of S x is S², so take the root of S": mean + x @ cov,
        "the mean is missing": x @ root,
        "the inverse root leads from the data to the noise": mean + x @ inverse,
        "a matrix root is not the root of each entry: take eigenvalues' roots": mean + x @ entries,
        "the coordinates are correlated: use all of S": mean + x * cov.diagonal().sqrt(),
        "the mean is added after the root": (x + mean) @ root,
    }
    hint = "the map is m + S^(1/2) x, row by row"
    yield Case((mean, cov, x), mean + x @ root, wrong, hint, "the images of x", tolerance=1e-3)


def _gradient(z: torch.Tensor) -> torch.Tensor:
    """The gradient of a convex function: tanh(z) plus a linear map with a positive matrix."""
    tilt = torch.tensor([0.3, -0.2], dtype=z.dtype)
    return torch.tanh(z) + 0.4 * z + 0.3 * z.flip(-1) + tilt


def _hessian(z: torch.Tensor) -> torch.Tensor:
    swap = torch.tensor([[0.4, 0.3], [0.3, 0.4]], dtype=z.dtype)
    return torch.diag_embed(1 - torch.tanh(z) ** 2) + swap


def _solve(x: torch.Tensor, t: float, *, steps: int = 60) -> torch.Tensor:
    z = x.double().clone()
    for _ in range(steps):
        residual = (1 - t) * z + t * _gradient(z) - x
        slope = (1 - t) * torch.eye(2, dtype=z.dtype) + t * _hessian(z)
        z = z - torch.linalg.solve(slope, residual)
    return z


@table("hw3.invert")
def invert(g: torch.Generator) -> Cases:
    """The solution z of (1 - t) z + t grad(z) = x."""
    few = torch.randn(8, 2, generator=g, dtype=torch.float64)
    # among many places there are some that need more steps; farther out full steps run in circles
    many = torch.randn(1000, 2, generator=g, dtype=torch.float64).clamp(-2.5, 2.5)
    for x, t in ((few, 0.6), (few, 0.0), (few, 0.9), (many, 0.9)):
        case = line_start(_solve(x, t), t, _gradient, _hessian)
        hint = "one Newton step is not enough: repeat until the residual is small"
        wrong = {**case.wrong, hint: _solve(x, t, steps=1)}
        yield replace(case, given=(_gradient, _hessian, x, t), wrong=wrong, tolerance=1e-4)


@table("hw3.ofm_loss")
def ofm_loss(g: torch.Generator) -> Cases:
    """The loss of each row, |grad(z0) - z0 - (x1 - x0)|^2 with z0 = invert(x_t, t)."""
    x0, x1 = (torch.randn(5, 2, generator=g, dtype=torch.float64) for _ in range(2))
    line = x1 - x0
    weight = torch.ones((), dtype=torch.float64, requires_grad=True)

    def gradient(z: torch.Tensor) -> torch.Tensor:
        return weight * _gradient(z)

    def squared(z: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        return (_gradient(z) - z - target).square().sum(1)

    for t in (0.7, 0.3):
        z0 = _solve((1 - t) * x0 + t * x1, t)
        back = _solve(t * x0 + (1 - t) * x1, t)
        moved = (z0 - x0).square().sum(1)
        right = squared(z0, line)
        wrong = {
            "|z0 - x0|² still has to be divided by t²; or use grad(z0) - z0 - (x1 - x0)": moved,
            "divide by t², not by t": moved / t,
            "the field at x_t is that of z0, which flows to x_t, not that of x0": squared(x0, line),
            "the target velocity is x1 - x0, not x0 - x1": squared(z0, -line),
            "the ends are swapped: x_t = (1 - t) x0 + t x1": squared(back, line),
            "the field is grad(z0) - z0": squared(z0, line - z0),
            "grad(z0) is where z0 ends; compare the *velocity* grad(z0) - z0": squared(z0, x1 - z0),
            "that is half of it: sum over the coordinates, do not average, and no 1/2": right / 2,
            "that is the distance; the loss is its square": right.sqrt(),
        }
        hint = "for each row: |grad(z0) - z0 - (x1 - x0)|²"
        case = Case((gradient, _solve, x0, x1, t), right, wrong, hint, "the loss")
        yield learnable(case, "the potential, through grad(z0)")


@table("hw3.l2_uvp")
def l2_uvp(g: torch.Generator) -> Cases:
    """L2-UVP in percent: 100 E|T - T*|^2 / trace(S)."""
    found, truth = torch.randn(9, 2, generator=g), torch.randn(9, 2, generator=g)
    cov = torch.tensor([[1.5, 0.4], [0.4, 0.7]])
    error, trace = (found - truth).square().sum(1).mean(), cov.trace()
    right = 100 * error / trace
    wrong = squares(found - truth, 100 / trace) | {
        "in percent: times 100": error / trace,
        "divide by the variance of the target, trace(S)": 100 * error,
        "the variance is trace(S), not det(S)": 100 * error / torch.linalg.det(cov),
        "only the diagonal of S counts: its trace": 100 * error / cov.sum(),
        "the trace is the sum of the diagonal": 2 * right,
        "divide by the variance, not by its root": 100 * error / trace.sqrt(),
        "no root: it is a share of variance": 100 * (error / trace).sqrt(),
    }
    yield Case((found, truth, cov), right, wrong)
