"""The checks of homework 1: flow matching from scratch."""

from __future__ import annotations

from typing import Any

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn.homework.checks.common import Case, Cases, one_a_row, table, tensor
from cotlearn.homework.registry import NotYet


@table("hw1.loss")
def loss(seed: int = 0) -> Cases:
    """|network(t, x_t) - (x1 - x0)|^2 for each row."""
    g = torch.Generator().manual_seed(seed)
    for n, d in ((5, 2), (3, 3)):  # in a square batch a forgotten t[:, None] raises nothing
        x0, x1 = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        yield _loss(x0, x1, torch.rand(n, generator=g) * 0.8 + 0.1)


def _loss(x0: Tensor, x1: Tensor, t: Tensor) -> Case:
    n, d = x0.shape

    def network(time: Any, x: Any) -> Tensor:
        if tuple(getattr(time, "shape", ())) != (n,):
            raise NotYet(f"the network takes the time first, of shape ({n},), then the place")
        if tuple(x.shape) != (n, d):
            raise NotYet(f"the place x_t must have shape ({n}, {d})")
        return _field(time, x)

    def squared(difference: Tensor) -> Tensor:
        return difference.square().sum(1)

    s = t[:, None]
    place, line = (1 - s) * x0 + s * x1, x1 - x0
    at, swapped = _field(t, place), _field(t, s * x0 + (1 - s) * x1)
    error = at - line
    wrong = {
        "the velocity has the wrong sign: the line runs from x0 to x1, so it is x1 - x0": (
            squared(at + line)
        ),
        "the ends are swapped: at t = 0 the place is x0, the noise": squared(swapped - line),
        "sum over the coordinates, do not average: |v|² is a sum": error.square().mean(1),
        "that is the distance; the loss is its square": error.norm(dim=1),
        "square the differences; these are their absolute values": error.abs().sum(1),
        "the network should predict the velocity x1 - x0, not the place x_t": squared(at - place),
        "the network should predict the velocity x1 - x0, not the end x1": squared(at - x1),
    }
    if n == d:
        hint = "t belongs to rows: in a square batch t without [:, None] is applied to columns"
        wrong[hint] = squared(_field(t, (1 - t) * x0 + t * x1) - line)
    hint = "for each row: the sum of (network(t, x_t) - (x1 - x0))²"
    return Case(
        (network, x0, x1, t), squared(error), wrong, hint, "the loss", shapes=one_a_row(n, d)
    )


@table("hw1.euler")
def euler(seed: int = 0) -> Cases:
    """nfe Euler steps from t = 0 to t = 1."""
    x0 = torch.randn(3, 2, generator=torch.Generator().manual_seed(seed)) * 0.5
    for nfe in (4, 1):
        calls: list[Any] = []

        def velocity(t: Any, x: Tensor, calls: list[Any] = calls) -> Tensor:
            calls.append(t)
            return _field(t, x)

        h = 1 / nfe
        wrong = {
            "you walk backwards: noise to data is x + h v": _steps(x0, nfe, -h, by=h),
            "the first step starts at t = 0, not at t = h": _steps(x0, nfe, h, first=h),
            "time runs from 0, the noise, to 1, the data": _steps(x0, nfe, h, first=1.0, by=-h),
            "evaluate the velocity where you are, not at x0": _steps(x0, nfe, h, still=True),
            "t moves on: step k starts at t = k / nfe": _steps(x0, nfe, h, by=0.0),
            "a step is x + h v with h = 1 / nfe: the h is missing": _steps(x0, nfe, 1.0, by=h),
            f"nfe={nfe} means {nfe} steps, you took {nfe + 1}": _steps(x0, nfe + 1, h),
        }
        if nfe > 1:
            late = 1 / (nfe - 1)
            wrong |= {
                f"you took {nfe - 1} steps and did not arrive at t = 1": _steps(x0, nfe - 1, h),
                "nfe steps of 1 / (nfe - 1) lead beyond t = 1; the step is 1 / nfe": (
                    _steps(x0, nfe, late)
                ),
                f"nfe={nfe} buys {nfe} steps of 1 / {nfe}; these are {nfe - 1} longer ones": (
                    _steps(x0, nfe - 1, late)
                ),
                "linspace(0, 1, nfe) ends at 1; step k starts at t = k / nfe": (
                    _steps(x0, nfe, h, by=late)
                ),
            }
        hint = "for k in range(nfe): x = x + v(k / nfe, x) / nfe"
        given = (velocity, x0, nfe)
        yield Case(given, _steps(x0, nfe, h), wrong, hint, "the states at t = 1")
        if len(calls) != nfe:
            raise NotYet(f"nfe={nfe} must evaluate the velocity {nfe} times, not {len(calls)}")


@table("hw1.exact_velocity")
def exact_velocity(seed: int = 0) -> Cases:
    """E[x1 - x0 | x_t = x] for a mixture of equal weights."""
    g = torch.Generator().manual_seed(seed)
    centres = torch.tensor([[2.0, 0.0], [-1.0, 1.5], [0.0, -2.0]])
    means = centres + 0.2 * torch.randn(3, 2, generator=g)
    x, s = torch.randn(6, 2, generator=g), 0.3
    for t in (0.3, 0.0, 0.8):
        given = (t, x, means, s)
        wrong = {
            "the components do not count alike: weigh each by its probability given x": (
                _mixture(*given, weights="equal")
            ),
            "at time t component k lies around t m_k, not around m_k": _mixture(*given, centre=1.0),
            "the variance of x_t is (1 - t)² + t² s²: t x1 has t² times x1's variance": (
                _mixture(*given, variance=(1 - t) ** 2 + t * s**2)
            ),
            "variances add with squared factors: (1 - t)² + t² s²": (
                _mixture(*given, variance=(1 - t) + t * s)
            ),
            "a Gaussian's exponent is -|x - m|² / (2 variance): the 2 is missing": (
                _mixture(*given, two=1.0)
            ),
            "Cov(x1 - x0, x_t) is t s² - (1 - t): the noise enters with a minus": (
                _mixture(*given, sign=1.0)
            ),
            "that is the mean of the m_k; x tells more: add Cov / Var times (x - t m_k)": (
                _mixture(*given, slope=False)
            ),
            "every component counts, not the nearest": _mixture(*given, weights="nearest"),
        }
        hint = f"at t = {t} it is not E[x1 - x0 | x_t = x]"
        yield Case(given, _mixture(*given), wrong, hint, "the velocity", tolerance=1e-3)
    far = (0.9, torch.tensor([[60.0, -45.0]]), means, 0.05)
    hint = "far from all components it is {}: use softmax of the logs, not exp and sum"

    def read(found: Any) -> Tensor:
        if isinstance(found, Tensor) and not found.isfinite().all():
            raise NotYet(hint.format("nan"))
        return tensor(found, (1, 2), "the velocity")

    yield Case(far, _mixture(*far), {}, hint.format("wrong"), read=read, tolerance=1e-3)


@table("hw1.squared_w2")
def squared_w2(seed: int = 0) -> Cases:
    """The mean squared distance of the best pairing of two samples."""
    g = torch.Generator().manual_seed(seed)
    for n, d in ((7, 2), (12, 3)):
        a = torch.randn(n, d, generator=g)
        b = 1.5 * torch.randn(n, d, generator=g) + 0.5
        far = torch.cdist(a.double(), b.double(), compute_mode="donot_use_mm_for_euclid_dist")
        cost = far.square()
        best, by_far = linear_sum_assignment(cost), linear_sum_assignment(far)
        most = linear_sum_assignment(cost, maximize=True)
        right = cost[best].mean()
        centres = (a.double().mean(0) - b.double().mean(0)).square().sum()
        wrong = {
            "that is W2; the *squared* distance is asked for: no root": right.sqrt(),
            "average over the pairs, do not sum": right * n,
            "sum over the coordinates, do not average them": right / d,
            "square the distances before the mean": far[best].mean(),
            "the cost is the squared distance": far[by_far].mean(),
            "find the best pairing for the squared distances, not for the distances": (
                cost[by_far].mean()
            ),
            "row i need not be paired with row i: find the best pairing": cost.diagonal().mean(),
            "each row of b may be used once: a pairing, not nearest neighbours": (
                cost.min(1).values.mean()
            ),
            "this averages over all pairs; find the best pairing": cost.mean(),
            "this is the most expensive pairing; the cheapest is asked for": cost[most].mean(),
            "that compares the means only": centres,
        }
        yield Case((a, b), right, wrong)
    yield Case((a, a.flip(0)), 0.0, {}, "the same points in another order are at distance 0")


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
        t += h if by is None else by
    return x


def _mixture(
    t: float,
    x: Tensor,
    means: Tensor,
    s: float,
    *,
    weights: str = "posterior",
    centre: float | None = None,
    variance: float | None = None,
    two: float = 2.0,
    sign: float = -1.0,
    slope: bool = True,
) -> Tensor:
    """The posterior mean of x1 - x0, and with other options the mistakes one can make in it."""
    x, means = x.double(), means.double()
    var = (1 - t) ** 2 + t**2 * s**2 if variance is None else variance
    away = x[:, None] - (t if centre is None else centre) * means
    w = torch.softmax(-away.square().sum(2) / (two * var), dim=1)
    if weights == "equal":
        w = torch.full_like(w, 1 / len(means))
    if weights == "nearest":
        w = torch.nn.functional.one_hot(w.argmax(1), len(means)).double()
    each = means + (t * s**2 + sign * (1 - t)) / var * away if slope else means.expand_as(away)
    return (w[:, :, None] * each).sum(1)
