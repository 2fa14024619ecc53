"""The checks of notebook 06."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from cotlearn.homework.checks.common import expect_function, number
from cotlearn.homework.registry import NotYet, exercise

Function = Callable[[Tensor], Tensor]
#: slope and curvature of convex functions of one variable
CONVEX: tuple[tuple[Function, Function], ...] = (
    (lambda z: 2 * z + 1, lambda z: torch.full_like(z, 2.0)),
    (lambda z: z + z**3, lambda z: 1 + 3 * z**2),
    (lambda z: 0.5 * z + torch.tanh(z), lambda z: 1.5 - torch.tanh(z) ** 2),
)


@exercise("06.start_of_line")
def start_of_line(answer: Any) -> None:
    """(1 - t) z + t slope(z) = x, to four digits."""
    expect_function(answer)
    starts = torch.linspace(-1.5, 1.5, 7)
    for t in (0.5, 0.3, 1.0, 0.0):
        for slope, curvature in CONVEX:
            x = (1 - t) * starts + t * slope(starts)
            found = _vector(answer(x.clone(), t, slope, curvature), 7)
            if torch.allclose(found, starts, atol=1e-3):
                continue
            ends = slope(found)
            for wrong, goal, hint in (
                (found, x, "that is x itself, where the line is at time t; where did it start?"),
                (found, slope(starts), "that is slope(z), where the line ends; return z"),
                (found, slope(starts) - starts, "that is the velocity slope(z) - z; return z"),
                (ends, x, "you solved slope(z) = x, which is the case t = 1"),
                ((1 - t) * ends + t * found, x, "t and 1 - t are swapped"),
            ):
                if torch.allclose(wrong, goal, atol=1e-3):
                    raise NotYet(hint)
            off = float(((1 - t) * found + t * ends - x).abs().max())
            if not found.isfinite().all() or off > 1:
                raise NotYet(
                    "the steps run away: Newton divides by the derivative of the whole left side, "
                    "(1 - t) + t curvature(z)"
                )
            raise NotYet(
                f"at t = {t} the two sides differ by {off:.2g} still; take more steps, and divide "
                "by (1 - t) + t curvature(z)"
            )


@exercise("06.uvp")
def uvp(answer: Any) -> None:
    """100 E|T - T*|^2 / Var, with Var the trace of the covariance of T*."""
    expect_function(answer)
    g = torch.Generator().manual_seed(6)
    for d in (2, 5):
        truth = torch.randn(40, d, generator=g) * torch.arange(1, d + 1) + 3 * torch.arange(d)
        mapped = truth + 0.7 * torch.randn(40, d, generator=g)
        value = number(answer(mapped.clone(), truth.clone()))
        squared = float((mapped - truth).square().sum(dim=1).mean())
        variance = float(truth.var(dim=0).sum())
        right = 100 * squared / variance
        if _close(value, right, 0.03):  # variances with n or n - 1
            continue
        second = float(truth.square().sum(dim=1).mean())
        mean_per_axis = float((mapped - truth).square().mean())
        for wrong, hint in (
            (right / 100, "in percent: 100 times that"),
            (
                100 * mean_per_axis / variance,
                "add the squared errors of the coordinates, mean over rows only",
            ),
            (
                100 * mean_per_axis / float(truth.var()),
                "each coordinate varies about its own mean: var(dim=0), then the sum",
            ),
            (
                100 * squared / float(truth.var()),
                "Var is the sum of the variances of the coordinates",
            ),
            (100 * squared / second, "Var is about the mean: E|x|^2 - |E x|^2"),
            (
                100 * squared / float(mapped.var(dim=0).sum()),
                "divide by the variance of the truth, not of your own map",
            ),
            (100 * (squared / variance) ** 0.5, "no square root: it is a ratio of squares"),
            (
                100 * float((mapped - truth).norm(dim=1).mean()) / variance,
                "the distance is squared before the mean is taken",
            ),
        ):
            if _close(value, wrong, 1e-3):
                raise NotYet(hint)
        raise NotYet(f"for a map with {d} coordinates expected {right:.2f}, got {value:.2f}")


@exercise("06.gap")
def gap(answer: Any) -> None:
    """For Psi(x) = a x^2/2 + b x the Fenchel-Young gap is (a x0 + b - x1)^2/(2 a)."""
    expect_function(answer)
    for a, b, x0, x1 in ((2.0, 1.0, 0.5, 3.0), (0.5, -1.0, 2.0, 1.5), (3.0, 0.0, -1.0, 2.0)):
        value = number(answer(a, b, x0, x1))
        psi, conjugate = a * x0**2 / 2 + b * x0, (x1 - b) ** 2 / (2 * a)
        right = psi + conjugate - x0 * x1
        if abs(value - right) < 1e-5 * (1 + abs(right)):
            continue
        for wrong, hint in (
            (psi + conjugate, "subtract x0 x1"),
            (2 * right, "that is the loss; the gap is half of it"),
            (2 * a * right, "that is the squared error of the map; the gap divides it by 2 a"),
            (psi + x1**2 / (2 * a) - x0 * x1, "the conjugate knows b: its z solves a z + b = x1"),
            (psi - conjugate - x0 * x1, "Psi* is <x1, z> - Psi(z): look at its sign"),
            (psi + (a * x1**2 / 2 + b * x1) - x0 * x1, "that is Psi(x1), not Psi*(x1)"),
            (psi + conjugate + x0 * x1, "x0 x1 is subtracted"),
        ):
            if abs(value - wrong) < 1e-5 * (1 + abs(wrong)):
                raise NotYet(hint)
        raise NotYet(f"for a = {a}, b = {b}, x0 = {x0}, x1 = {x1} expected {right:.4g}")


def _close(value: float, other: float, tolerance: float) -> bool:
    return abs(value - other) <= tolerance * abs(other)


def _vector(value: Any, rows: int) -> Tensor:
    if not isinstance(value, Tensor) or value.shape != (rows,):
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        raise NotYet(f"return a tensor of shape ({rows},), like x, got {got}")
    return value.detach().float()
