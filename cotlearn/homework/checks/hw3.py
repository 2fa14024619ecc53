"""The checks of homework 3: optimal vector fields."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from cotlearn.homework.checks.common import compare, expect_function, number, tensor
from cotlearn.homework.registry import NotYet, exercise


@exercise("hw3.gaussian_map")
def gaussian_map(answer: Any, seed: int = 0) -> None:
    """m + S^(1/2) x."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    root = torch.tensor([[1.2, 0.5], [0.5, 0.6]]) + 0.1 * torch.rand(1, generator=g)
    mean, x = torch.tensor([2.0, -1.0]), torch.randn(6, 2, generator=g)
    cov = root @ root
    got = tensor(answer(mean.clone(), cov.clone(), x.clone()), (6, 2), "the images of x")
    lower = torch.linalg.cholesky(cov)
    mistakes = [
        (
            mean + x @ lower.T,
            "that has the right law, but Cholesky's map turns the points: the optimal one is the "
            "symmetric root",
        ),
        (
            mean + x @ lower,
            "that has another law, and is not symmetric: take the symmetric root, eigh helps",
        ),
        (mean + x @ cov, "that is S x; the covariance of S x is S², so take the root of S"),
        (x @ root, "the mean is missing"),
        (mean + x @ torch.linalg.inv(root), "the inverse root leads from the data to the noise"),
        (
            mean + x @ cov.abs().sqrt(),
            "a matrix root is not the root of each entry: take eigenvalues' roots",
        ),
        (mean + x * cov.diagonal().sqrt(), "the coordinates are correlated: use all of S"),
        ((x + mean) @ root, "the mean is added after the root"),
    ]
    compare(got, mean + x @ root, mistakes, "the map is m + S^(1/2) x, row by row", tolerance=1e-3)


def _gradient(z: Tensor) -> Tensor:
    """Of the convex sum over coordinates of log cosh z + |z|²/5, plus a tilt."""
    tilt = torch.tensor([0.3, -0.2], dtype=z.dtype)
    return torch.tanh(z) + 0.4 * z + 0.3 * z.flip(-1) + tilt


def _hessian(z: Tensor) -> Tensor:
    swap = torch.tensor([[0.4, 0.3], [0.3, 0.4]], dtype=z.dtype)
    return torch.diag_embed(1 - torch.tanh(z) ** 2) + swap


def _solve(x: Tensor, t: float, *, steps: int = 60) -> Tensor:
    z = x.double().clone()
    for _ in range(steps):
        residual = (1 - t) * z + t * _gradient(z) - x
        slope = (1 - t) * torch.eye(2, dtype=z.dtype) + t * _hessian(z)
        z = z - torch.linalg.solve(slope, residual)
    return z


@exercise("hw3.invert")
def invert(answer: Any, seed: int = 0) -> None:
    """The z with (1 - t) z + t grad(z) = x."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    x = torch.randn(8, 2, generator=g, dtype=torch.float64)
    for t in (0.6, 0.0, 0.9):
        got = tensor(answer(_gradient, _hessian, x.clone(), t), (8, 2), "z")
        right = _solve(x, t)
        mistakes = [
            (_solve(x, 1 - t), "t and 1 - t are swapped: (1 - t) z + t grad(z) = x"),
            (
                _solve(x, t, steps=1),
                "one Newton step is not enough: repeat it until the residual is small",
            ),
            (_solve(x, 1.0), "the (1 - t) z is missing: that solves grad(z) = x"),
            (_gradient(x), "that goes forward; the z that leads to x is asked for"),
            (
                (1 - t) * x + t * _gradient(x),
                "that goes forward, from z to x; solve the equation for z",
            ),
            (x.clone() if t else x + 1, "that is x itself: solve (1 - t) z + t grad(z) = x"),
        ]
        try:
            compare(got, right, mistakes, "", tolerance=1e-4)
        except NotYet as reason:
            left = ((1 - t) * got + t * _gradient(got) - x).norm(dim=1).max()
            raise NotYet(
                str(reason)
                or f"at t = {t} the residual |(1 - t) z + t grad(z) - x| is up to {left:.2g}; "
                "more Newton steps, or the sign of the step?"
            ) from None


@exercise("hw3.ofm_loss")
def ofm_loss(answer: Any, seed: int = 0) -> None:
    """|grad(z0) - z0 - (x1 - x0)|^2 for each row, z0 = invert(x_t, t)."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    x0, x1 = (torch.randn(5, 2, generator=g, dtype=torch.float64) for _ in range(2))
    for t in (0.7, 0.3):
        found = answer(_gradient, _solve, x0.clone(), x1.clone(), t)
        if isinstance(found, Tensor) and found.ndim == 0:
            raise NotYet("return one loss for each row; the mean over rows is taken later")
        if isinstance(found, Tensor) and tuple(found.shape) == (5, 2):
            raise NotYet("sum the squares over the coordinates: one loss for each row")
        got = tensor(found, (5,), "the loss")
        z0 = _solve((1 - t) * x0 + t * x1, t)
        back = _solve(t * x0 + (1 - t) * x1, t)
        field = _gradient(z0) - z0
        right = (field - (x1 - x0)).square().sum(1)
        mistakes = [
            (
                (z0 - x0).square().sum(1),
                "|z0 - x0|² still has to be divided by t²; or use grad(z0) - z0 - (x1 - x0)",
            ),
            ((z0 - x0).square().sum(1) / t, "divide by t², not by t"),
            (
                (_gradient(x0) - x0 - (x1 - x0)).square().sum(1),
                "the field at x_t is that of z0, the point that flows to x_t, not that of x0",
            ),
            (
                (field + (x1 - x0)).square().sum(1),
                "the target velocity is x1 - x0, not x0 - x1",
            ),
            (
                (_gradient(back) - back - (x1 - x0)).square().sum(1),
                "the ends are swapped: x_t = (1 - t) x0 + t x1",
            ),
            ((_gradient(z0) - (x1 - x0)).square().sum(1), "the field is grad(z0) - z0"),
            (
                (_gradient(z0) - x1).square().sum(1),
                "grad(z0) is where z0 ends; the *velocity* grad(z0) - z0 is compared with x1 - x0",
            ),
            (right / 2, "sum over the coordinates, do not average"),
            (right.sqrt(), "that is the distance; the loss is its square"),
        ]
        compare(got, right, mistakes, "for each row: |grad(z0) - z0 - (x1 - x0)|²")


@exercise("hw3.l2_uvp")
def l2_uvp(answer: Any, seed: int = 0) -> None:
    """100 E|T - T*|^2 / trace(S)."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    found, truth = torch.randn(9, 2, generator=g), torch.randn(9, 2, generator=g)
    cov = torch.tensor([[1.5, 0.4], [0.4, 0.7]])
    got = number(answer(found.clone(), truth.clone(), cov.clone()))
    error = float((found - truth).square().sum(1).mean())
    trace = float(cov.trace())
    right = 100 * error / trace
    mistakes = [
        (error / trace, "in percent: times 100"),
        (100 * error, "divide by the variance of the target, trace(S)"),
        (right / 2, "sum the squares over the coordinates, average over the rows only"),
        (right * 9, "average over the rows, do not sum"),
        (100 * error / float(torch.linalg.det(cov)), "the variance is trace(S), not det(S)"),
        (100 * error / float(cov.sum()), "only the diagonal of S counts: its trace"),
        (100 * error / float(cov.diagonal().mean()), "the trace is the sum of the diagonal"),
        (100 * error / math.sqrt(trace), "divide by the variance, not by its root"),
        (
            100 * float((found - truth).norm(dim=1).mean()) / trace,
            "square the distances before the mean",
        ),
        (100 * math.sqrt(error / trace), "no root: it is a share of variance"),
    ]
    compare(got, right, mistakes, f"expected {right:.3f}, got {got:.3f}")
