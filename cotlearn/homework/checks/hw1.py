"""The checks of homework 1: flow matching from scratch."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn.homework.checks.common import compare, expect_function, number, same, tensor
from cotlearn.homework.registry import NotYet, exercise


@exercise("hw1.loss")
def loss(answer: Any, seed: int = 0) -> None:
    """|network(t, x_t) - (x1 - x0)|^2 for each row."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    for n, d in ((5, 2), (3, 3)):  # in a square batch a forgotten t[:, None] raises nothing
        x0, x1 = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        t = torch.rand(n, generator=g) * 0.8 + 0.1

        def network(time: Any, x: Any, rows: int = n, columns: int = d) -> Tensor:
            if tuple(getattr(time, "shape", ())) != (rows,):
                raise NotYet(
                    f"the network takes the time first, of shape ({rows},), then the place"
                )
            if tuple(x.shape) != (rows, columns):
                raise NotYet(f"the place x_t must have shape ({rows}, {columns})")
            return _field(time, x)

        found = answer(network, x0.clone(), x1.clone(), t.clone())
        if isinstance(found, Tensor) and found.ndim == 0:
            raise NotYet("return one loss for each row; the mean over rows is taken later")
        if isinstance(found, Tensor) and tuple(found.shape) == (n, d):
            raise NotYet("sum the squares over the coordinates: one loss for each row")
        got = tensor(found, (n,), "the loss")
        s = t[:, None]
        place = (1 - s) * x0 + s * x1
        error = _field(t, place) - (x1 - x0)
        right = error.square().sum(1)
        mistakes = [
            (
                (_field(t, place) + (x1 - x0)).square().sum(1),
                "the velocity has the wrong sign: the line runs from x0 to x1, so it is x1 - x0",
            ),
            (
                (_field(t, s * x0 + (1 - s) * x1) - (x1 - x0)).square().sum(1),
                "the ends are swapped: at t = 0 the place is x0, the noise",
            ),
            (error.square().mean(1), "sum over the coordinates, do not average: |v|² is a sum"),
            (error.norm(dim=1), "that is the distance; the loss is its square"),
            (error.abs().sum(1), "square the differences; these are their absolute values"),
            (
                (_field(t, place) - place).square().sum(1),
                "the network should predict the velocity x1 - x0, not the place x_t",
            ),
            (
                (_field(t, place) - x1).square().sum(1),
                "the network should predict the velocity x1 - x0, not the end x1",
            ),
        ]
        if n == d:
            mixed = (1 - t) * x0 + t * x1
            mistakes.append(
                (
                    (_field(t, mixed) - (x1 - x0)).square().sum(1),
                    "t belongs to rows: in a square batch t without [:, None] meets columns",
                )
            )
        compare(got, right, mistakes, "for each row: the sum of (network(t, x_t) - (x1 - x0))²")


@exercise("hw1.euler")
def euler(answer: Any, seed: int = 0) -> None:
    """nfe Euler steps from t = 0 to t = 1."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    x0 = torch.randn(3, 2, generator=g) * 0.5
    for nfe in (4, 1):
        calls = 0

        def velocity(t: Any, x: Tensor) -> Tensor:
            nonlocal calls
            calls += 1
            return _field(t, x)

        got = tensor(answer(velocity, x0.clone(), nfe), (3, 2), "the states at t = 1")
        h = 1 / nfe
        mistakes = [
            (_steps(x0, nfe, -h), "you walk backwards: noise to data is x + h v"),
            (_steps(x0, nfe, h, first=h), "the first step starts at t = 0, not at t = h"),
            (
                _steps(x0, nfe, h, first=1.0, by=-h),
                "time runs from 0, the noise, to 1, the data",
            ),
            (_steps(x0, nfe, h, still=True), "look at the velocity where you are, not at x0"),
            (_steps(x0, nfe, h, by=0.0), "t moves on: step k starts at t = k / nfe"),
            (_steps(x0, nfe, 1.0, by=h), "a step is x + h v with h = 1 / nfe: the h is missing"),
            (_steps(x0, nfe + 1, h), f"nfe={nfe} means {nfe} steps, you took {nfe + 1}"),
        ]
        if nfe > 1:
            late = 1 / (nfe - 1)
            mistakes += [
                (_steps(x0, nfe - 1, h), f"you took {nfe - 1} steps and did not arrive at t = 1"),
                (
                    _steps(x0, nfe, late, by=late),
                    "nfe steps of 1 / (nfe - 1) lead beyond t = 1; the step is 1 / nfe",
                ),
                (
                    _steps(x0, nfe - 1, late, by=late),
                    f"nfe={nfe} buys {nfe} steps of 1 / {nfe}; these are {nfe - 1} longer ones",
                ),
                (
                    _steps(x0, nfe, h, by=late),
                    "linspace(0, 1, nfe) ends at 1; step k starts at t = k / nfe",
                ),
            ]
        compare(
            got, _steps(x0, nfe, h), mistakes, "for k in range(nfe): x = x + v(k / nfe, x) / nfe"
        )
        if calls != nfe:
            raise NotYet(f"nfe={nfe} must evaluate the velocity {nfe} times, not {calls}")


@exercise("hw1.exact_velocity")
def exact_velocity(answer: Any, seed: int = 0) -> None:
    """E[x1 - x0 | x_t = x] for a mixture of equal weights."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    means = torch.tensor([[2.0, 0.0], [-1.0, 1.5], [0.0, -2.0]]) + 0.2 * torch.randn(
        3, 2, generator=g
    )
    x, s = torch.randn(6, 2, generator=g), 0.3
    for t in (0.3, 0.0, 0.8):
        got = tensor(answer(t, x.clone(), means.clone(), s), (6, 2), "the velocity")
        right = _mixture(t, x, means, s)
        mistakes = [
            (
                _mixture(t, x, means, s, weights="equal"),
                "the components do not count alike: weigh each by its probability given x",
            ),
            (
                _mixture(t, x, means, s, centre=1.0),
                "at time t component k lies around t m_k, not around m_k",
            ),
            (
                _mixture(t, x, means, s, variance=lambda t, s: (1 - t) ** 2 + t * s**2),
                "the variance of x_t is (1 - t)² + t² s²: t x1 has t² times x1's variance",
            ),
            (
                _mixture(t, x, means, s, variance=lambda t, s: (1 - t) + t * s),
                "variances add with squared factors: (1 - t)² + t² s²",
            ),
            (
                _mixture(t, x, means, s, two=1.0),
                "a Gaussian's exponent is -|x - m|² / (2 variance): the 2 is missing",
            ),
            (
                _mixture(t, x, means, s, sign=1.0),
                "Cov(x1 - x0, x_t) is t s² - (1 - t): the noise enters with a minus",
            ),
            (
                _mixture(t, x, means, s, slope=False),
                "that is the mean of the m_k; x tells more: add Cov / Var times (x - t m_k)",
            ),
            (_mixture(t, x, means, s, nearest=True), "every component counts, not the nearest"),
        ]
        compare(got, right, mistakes, f"at t = {t} it is not E[x1 - x0 | x_t = x]", tolerance=1e-3)
    far = torch.tensor([[60.0, -45.0]])
    found = answer(0.9, far, means.clone(), 0.05)
    if isinstance(found, Tensor) and not torch.isfinite(found).all():
        raise NotYet("far from all components it is nan: use softmax of the logs, not exp and sum")
    compare(
        tensor(found, (1, 2), "the velocity far out"),
        _mixture(0.9, far, means, 0.05),
        [],
        "far from all components it is wrong: use softmax of the logs, not exp and sum",
        tolerance=1e-3,
    )


@exercise("hw1.squared_w2")
def squared_w2(answer: Any, seed: int = 0) -> None:
    """The mean squared distance of the best pairing of two samples."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    for n, d in ((7, 2), (12, 3)):
        a = torch.randn(n, d, generator=g)
        b = 1.5 * torch.randn(n, d, generator=g) + 0.5
        found = number(answer(a.clone(), b.clone()))
        cost = torch.cdist(a.double(), b.double(), compute_mode="donot_use_mm_for_euclid_dist")
        rows, columns = linear_sum_assignment(cost.square())
        right = float(cost.square()[rows, columns].mean())
        by_distance = linear_sum_assignment(cost)[1]
        mistakes = [
            (math.sqrt(right), "that is W2; the *squared* distance is asked for: no root"),
            (right * n, "average over the pairs, do not sum"),
            (right / d, "sum over the coordinates, do not average them"),
            (float(cost[rows, columns].mean()), "square the distances before the mean"),
            (float(cost[range(n), by_distance].mean()), "the cost is the squared distance"),
            (
                float(cost.square()[range(n), by_distance].mean()),
                "find the best pairing for the squared distances, not for the distances",
            ),
            (
                float(cost.square().diagonal().mean()),
                "row i need not be paired with row i: find the best pairing",
            ),
            (
                float(cost.square().min(1).values.mean()),
                "each row of b may be used once: a pairing, not nearest neighbours",
            ),
            (float(cost.square().mean()), "this averages over all pairs; find the best pairing"),
            (
                float(cost.square()[linear_sum_assignment(cost.square(), maximize=True)].mean()),
                "this is the dearest pairing; the cheapest is asked for",
            ),
            (
                float((a.double().mean(0) - b.double().mean(0)).square().sum()),
                "that compares the means only",
            ),
        ]
        compare(found, right, mistakes, f"expected {right:.4f} for two samples, got {found:.4f}")
    if not same(number(answer(a, a.flip(0))), 0):
        raise NotYet("the same points in another order are at distance 0")


def _field(t: Any, x: Tensor) -> Tensor:
    """A velocity that depends on both; t is a number or one for each row."""
    time = torch.as_tensor(t, dtype=x.dtype)
    return torch.cos(2 * x) + 1.5 * (time[:, None] if time.ndim == 1 else time) * x - 0.3


def _steps(
    x: Tensor,
    steps: int,
    h: float,
    *,
    first: float = 0.0,
    by: float | None = None,
    still: bool = False,
) -> Tensor:
    """Euler, and with other options the mistakes one can make in it."""
    start, t = x, first
    for _ in range(steps):
        x = x + h * _field(t, start if still else x)
        t += abs(h) if by is None else by
    return x


def _mixture(
    t: float,
    x: Tensor,
    means: Tensor,
    s: float,
    *,
    weights: str = "posterior",
    centre: float | None = None,
    variance: Callable[[float, float], float] = lambda t, s: (1 - t) ** 2 + t**2 * s**2,
    two: float = 2.0,
    sign: float = -1.0,
    slope: bool = True,
    nearest: bool = False,
) -> Tensor:
    """The posterior mean of x1 - x0, and with other options the mistakes one can make in it."""
    x, means = x.double(), means.double()
    var = variance(t, s)
    away = x[:, None] - (t if centre is None else centre) * means
    w = torch.softmax(-away.square().sum(2) / (two * var), dim=1)
    if weights == "equal":
        w = torch.full_like(w, 1 / len(means))
    if nearest:
        w = torch.nn.functional.one_hot(w.argmax(1), len(means)).double()
    each = means + (t * s**2 + sign * (1 - t)) / var * away if slope else means.expand_as(away)
    return (w[:, :, None] * each).sum(1)
