"""The checks of notebook 13."""

import math

import torch
from torch import Tensor

from .common import Case, Cases, table


@table("13.mean_velocity", seed=13)
def mean_velocity(g: torch.Generator) -> Cases:
    """The mean velocity of dx/dt = a x from t to r, x (exp(a (r - t)) - 1) / (r - t)."""
    x, a, t, r = torch.randn(6, 2, generator=g), -1.5, 0.1, 0.8
    grown = math.expm1(a * (r - t))
    wrong = {
        "that is the velocity at t, but it changes on the way": a * x,
        "that is the way from t to r: divide it by the time r - t": grown * x,
        "that is the place at r: subtract x, then divide by r - t": (grown + 1) * x,
        "the clock starts at t: the growth is exp(a (r - t))": math.expm1(a * r) / (r - t) * x,
        "the mean of both ends is not the mean over the time": a * (grown + 2) / 2 * x,
    }
    yield Case((x, t, r, a), grown / (r - t) * x, wrong, what="the mean velocity")


@table("13.halves", seed=13)
def halves(g: torch.Generator) -> Cases:
    """The mean velocity from t to r, from those of t to s and of s to r."""
    first, second = torch.randn(2, 6, 2, generator=g)
    t, s, r = 0.2, 0.4, 0.9
    way, swapped = (s - t) * first + (r - s) * second, (r - s) * first + (s - t) * second
    wrong = {
        "the pieces are not equally long: weight each by its time": (first + second) / 2,
        "that is the whole way: divide it by the whole time r - t": way,
        "the first piece lasts s - t, the second r - s": swapped / (r - t),
        "divide by the time r - t, not by the end r": way / r,
        "the way ends at r, not at 1": (way + (1 - r) * second) / (1 - t),
    }
    yield Case((first, second, t, s, r), way / (r - t), wrong, what="the mean velocity")


@table("13.drift", seed=13)
def drift(g: torch.Generator) -> Cases:
    """Where samples of a group move: the mean of near data less that of near other samples."""
    for m, n, h in ((5, 8, 1.0), (4, 3, 0.5)):
        y, data = torch.randn(m, 2, generator=g), 1 + torch.randn(n, 2, generator=g)
        to_data, to_others = torch.cdist(y, data), torch.cdist(y, y)
        with_itself = _near(to_others, y, h)
        to_others = to_others.fill_diagonal_(torch.inf)
        pull, push = _near(to_data, data, h), _near(to_others, y, h)
        wrong = {
            "a sample is not compared with itself: leave it out of the other samples": pull
            - with_itself,
            "subtract the mean of the other samples near it, not the sample": pull - y,
            "the data pull and the samples push: data minus samples": push - pull,
            "near rows count most: a minus before the distance": _near(-to_data, data, h)
            - _near(-torch.cdist(y, y).fill_diagonal_(-torch.inf), y, h),
            "weigh the rows by their nearness": (data.mean(dim=0) - y.mean(dim=0)).expand(m, 2),
            "divide the distances by h": _near(to_data, data, 1.0) - _near(to_others, y, 1.0),
            "the distance, not its square": _near(to_data.square(), data, h)
            - _near(to_others.square(), y, h),
            "that is the mean of the data near it: subtract that of the other samples": pull,
        }
        if h == 1:
            del wrong["divide the distances by h"]
        yield Case((y, data, h), pull - push, wrong, what="the move")


def _near(distance: Tensor, rows: Tensor, h: float) -> Tensor:
    """The means of rows (n, d), weighted by the softmax of -distance / h, (m, d)."""
    return (-distance / h).softmax(dim=1) @ rows
