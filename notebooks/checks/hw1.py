"""The checks of homework 1: flow matching from scratch."""

import functools
from typing import Any

import torch
from torch import Generator, Tensor

from cotlearn.course.checking import NotYet

from .common import Case, Cases, cheapest, field_at, learnable, squares, table


@table("hw1.loss")
def loss(g: Generator) -> Cases:
    """The flow matching loss of each row, |network(t, x_t) - (x1 - x0)|^2."""
    # in a square batch a forgotten t[:, None] raises nothing; in two columns a mean is a half
    for n, d in ((5, 3), (3, 3)):
        x0, x1 = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        yield _loss(x0, x1, torch.rand(n, generator=g) * 0.8 + 0.1)


def _loss(x0: Tensor, x1: Tensor, t: Tensor) -> Case:
    n, d = x0.shape
    weight = torch.ones((), requires_grad=True)

    def network(time: Any, x: Any) -> Tensor:
        if tuple(getattr(time, "shape", ())) != (n,):
            raise NotYet(f"the network takes the time first, of shape ({n},), then the place")
        if tuple(x.shape) != (n, d):
            raise NotYet(f"the place x_t must have shape ({n}, {d})")
        return weight * field_at(time, x)

    def squared(place: Tensor, target: Tensor) -> Tensor:
        return (field_at(t, place) - target).square().sum(1)

    s = t[:, None]
    place, line = (1 - s) * x0 + s * x1, x1 - x0
    error = field_at(t, place) - line
    by_column = (1 - t) * x0 + t * x1 if n == d else place
    wrong = {
        "the velocity has the wrong sign: from x0 to x1 it is x1 - x0": squared(place, -line),
        "the ends are swapped: at t = 0 the place is x0, the noise": squared(x0 + x1 - place, line),
        "sum over the coordinates, do not average: |v|² is a sum": error.square().mean(1),
        "that is half of it: |v|² has no factor 1/2": error.square().sum(1) / 2,
        "that is the distance; the loss is its square": error.norm(dim=1),
        "square the differences; these are their absolute values": error.abs().sum(1),
        "the network predicts the velocity x1 - x0, not the place x_t": squared(place, place),
        "the network predicts the velocity x1 - x0, not the end x1": squared(place, x1),
        "t belongs to rows: in a square batch t[:, None], not t": squared(by_column, line),
    }
    hint = "for each row: the sum of (network(t, x_t) - (x1 - x0))²"
    case = Case((network, x0, x1, t), squared(place, line), wrong, hint, "the loss")
    return learnable(case, "the network")


@table("hw1.euler")
def euler(g: Generator) -> Cases:
    """The result of nfe Euler steps from t = 0 to t = 1."""
    x0 = torch.randn(3, 2, generator=g) * 0.5

    def velocity(time: Any, x: Tensor) -> Tensor:
        if tuple(getattr(time, "shape", ())) != x.shape[:1]:
            raise NotYet(f"give the velocity a tensor of times, one for each row: {times}")
        return field_at(time, x)

    times = "torch.full((len(x),), k / nfe)"
    for nfe in (4, 1):
        walk, h, late = functools.partial(_steps, x0), 1 / nfe, 1 / max(nfe - 1, 1)
        wrong = {
            "you walk backwards: noise to data is x + h v": walk(nfe, -h, by=h),
            "the first step starts at t = 0, not at t = h": walk(nfe, h, first=h),
            "time runs from 0, the noise, to 1, the data": walk(nfe, h, first=1, by=-h),
            "evaluate the velocity where you are, not at x0": walk(nfe, h, still=True),
            "t moves on: step k starts at t = k / nfe": walk(nfe, h, by=0),
            "a step is x + h v with h = 1 / nfe: the h is missing": walk(nfe, 1, by=h),
            f"nfe={nfe} means {nfe} steps, you took {nfe + 1}": walk(nfe + 1, h),
            f"you took {nfe - 1} steps and did not arrive at t = 1": walk(nfe - 1, h),
            "nfe steps of 1 / (nfe - 1) lead beyond t = 1; the step is 1 / nfe": walk(nfe, late),
            "nfe evaluations buy nfe steps; these are nfe - 1 longer ones": walk(nfe - 1, late),
            "linspace(0, 1, nfe) ends at 1; step k starts at t = k / nfe": walk(nfe, h, by=late),
        }
        hint = f"for k in range(nfe): x = x + velocity({times}, x) / nfe"
        yield Case((velocity, x0, nfe), walk(nfe, h), wrong, hint, "the states at t = 1", nfe=nfe)


@table("hw1.exact_velocity")
def exact_velocity(g: Generator) -> Cases:
    """The exact velocity E[x1 - x0 | x_t = x] for a Gaussian mixture with equal weights."""
    centres = torch.tensor([[2.0, 0.0], [-1.0, 1.5], [0.0, -2.0]])
    means = centres + 0.2 * torch.randn(3, 2, generator=g)
    x, rows, s = torch.randn(6, 2, generator=g), range(6), 0.3
    for t in (0.3, 0.0, 0.8):
        given = (t, x, means, s)
        mean = functools.partial(_velocity, *given)
        posterior, each = _mixture(*given)
        one_square, no_square = (1 - t) ** 2 + t * s**2, (1 - t) + t * s
        middle = (posterior * means).sum(1)
        wrong = {
            "components count by their probability given x, not alike": each.mean(1),
            "at time t component k lies around t m_k, not around m_k": mean(centre=1.0),
            "the variance is (1 - t)² + t² s²: that of t x1 has a t²": mean(variance=one_square),
            "variances add with squared factors: (1 - t)² + t² s²": mean(variance=no_square),
            "a Gaussian's exponent is -|x - m|² / (2 variance): the 2 is missing": mean(two=1.0),
            "Cov(x1 - x0, x_t) is t s² - (1 - t): the noise enters with a minus": mean(sign=1.0),
            "the softmax runs over the points; a point's components sum to 1": mean(over=0),
            "that is the mean of the m_k; add Cov / Var times (x - t m_k)": middle,
            "every component counts, not the nearest": each[rows, posterior[:, :, 0].argmax(1)],
        }
        hint = f"at t = {t} it is not E[x1 - x0 | x_t = x]"
        yield Case(given, mean(), wrong, hint, "the velocity", tolerance=1e-3)
    far = (0.9, torch.tensor([[60.0, -45.0]]), means, 0.05)
    what = "the velocity far from all components: use softmax of the logs, not exp and sum"
    yield Case(far, _velocity(*far), {}, f"wrong is {what}", what, tolerance=1e-3)


@table("hw1.squared_w2")
def squared_w2(g: Generator) -> Cases:
    """The mean squared distance between two samples under their optimal pairing."""
    for n, d in ((7, 2), (12, 3)):
        a = torch.randn(n, d, generator=g).double()
        b = (1.5 * torch.randn(n, d, generator=g) + 0.5).double()
        far = torch.cdist(a, b, compute_mode="donot_use_mm_for_euclid_dist")
        cost, rows = far.square(), range(n)
        best, by_far, most = map(cheapest, (cost, far, -cost))
        right = (a - b[best]).square().sum(1).mean()
        nearest = cost.min(1).values.mean()
        wrong = squares(a - b[best]) | {
            "that is W2; the *squared* distance is asked for: no root": right.sqrt(),
            "find the best pairing for squared distances, not distances": cost[rows, by_far].mean(),
            "row i need not be paired with row i: find the best pairing": cost.diagonal().mean(),
            "each row of b may be used once: a pairing, not nearest neighbours": nearest,
            "this averages over all pairs; find the best pairing": cost.mean(),
            "this is the most expensive pairing; find the cheapest": cost[rows, most].mean(),
            "that compares the means only": (a.mean(0) - b.mean(0)).square().sum(),
        }
        yield Case((a.float(), b.float()), right, wrong)
    hint = "the same points in another order are at distance 0"
    yield Case((a.float(), a.flip(0).float()), 0.0, {}, hint)


def _steps(
    x: Tensor, n: int, h: float, *, first: float = 0.0, by: float | None = None, still: bool = False
) -> Tensor:
    """Euler's method; the options reproduce typical mistakes."""
    start, t = x, first
    for _ in range(n):
        x = x + h * field_at(t, start if still else x)
        t += h if by is None else by
    return x


def _mixture(t: float, x: Tensor, means: Tensor, s: float, **slip: float) -> tuple[Tensor, Tensor]:
    """The components' posterior (n, k, 1), and E[x1 - x0 | x_t, component] (n, k, d).

    Typical mistakes: another `centre` of the components, `variance`, factor `two` or `sign`, or a
    softmax `over` the points.
    """
    x, means = x.double(), means.double()
    var = slip.get("variance", (1 - t) ** 2 + t**2 * s**2)
    two, sign = slip.get("two", 2.0), slip.get("sign", -1.0)
    away = x[:, None] - slip.get("centre", t) * means
    over = int(slip.get("over", 1))
    posterior = torch.softmax(-away.square().sum(2, keepdim=True) / (two * var), dim=over)
    return posterior, means + (t * s**2 + sign * (1 - t)) / var * away


def _velocity(*given: Any, **slip: Any) -> Tensor:
    posterior, each = _mixture(*given, **slip)
    return (posterior * each).sum(1)
