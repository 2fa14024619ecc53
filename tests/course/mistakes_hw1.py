"""Typical wrong answers to homework 1, and words of the hint that each must get."""

import math

import torch
from scipy.optimize import linear_sum_assignment


def place(x0, x1, t):
    return (1 - t[:, None]) * x0 + t[:, None] * x1


def errors(network, x0, x1, t):
    return network(t, place(x0, x1, t)) - (x1 - x0)


def loss_of(target, where=place):
    return lambda v, x0, x1, t: (v(t, where(x0, x1, t)) - target(x0, x1, t)).square().sum(1)


def walk(velocity, x0, nfe, *, start=0.0, h=None, sign=1, by=None, steps=None, still=False):
    h = 1 / nfe if h is None else h
    x, t = x0, start
    for _ in range(nfe if steps is None else steps):
        x = x + sign * h * velocity(torch.full((len(x),), t), x0 if still else x)
        t += h if by is None else by
    return x


def numbers_as_times(velocity, x, nfe):
    for k in range(nfe):
        x = x + velocity(k / nfe, x) / nfe
    return x


def mixture(t, x, means, s, *, centre=None, of_s=2, two=2, sign=-1, kind="softmax"):
    var = (1 - t) ** 2 + t**of_s * s**2
    away = x[:, None] - (t if centre is None else centre) * means
    logs = -away.square().sum(2) / (two * var)
    weights = torch.softmax(logs, 0 if kind == "points" else 1)
    if kind == "equal":
        weights = torch.ones_like(weights) / len(means)
    if kind == "exp":
        weights = logs.exp() / logs.exp().sum(1, keepdim=True)
    if kind == "nearest":
        weights = torch.nn.functional.one_hot(logs.argmax(1), len(means)).to(x)
    slope = 0 if kind == "flat" else (t * s**2 + sign * (1 - t)) / var
    return (weights[:, :, None] * (means + slope * away)).sum(1)


def costs(a, b):
    return torch.cdist(a, b).square()


def best(a, b):
    return costs(a, b)[linear_sum_assignment(costs(a, b))]


MISTAKES = [
    ("hw1.loss", loss_of(lambda x0, x1, t: x0 - x1), "wrong sign"),
    ("hw1.loss", loss_of(lambda a, b, t: b - a, lambda a, b, t: place(b, a, t)), "swapped"),
    ("hw1.loss", loss_of(lambda x0, x1, t: x1), "not the end"),
    ("hw1.loss", loss_of(place), "not the place"),
    ("hw1.loss", loss_of(lambda a, b, t: b - a, lambda a, b, t: (1 - t) * a + t * b), "t[:, None]"),
    ("hw1.loss", lambda *a: errors(*a).square().mean(1), "do not average"),
    ("hw1.loss", lambda *a: errors(*a).square().sum(1) / 2, "no factor 1/2"),
    ("hw1.loss", torch.no_grad()(lambda *a: errors(*a).square().sum(1)), "no gradient reaches"),
    ("hw1.loss", lambda *a: errors(*a).square().sum(1).detach(), "drop no_grad, detach"),
    ("hw1.loss", lambda *a: errors(*a).square().mean(), "one value for each row"),
    ("hw1.loss", lambda *a: errors(*a).square(), "sum over the coordinates"),
    ("hw1.loss", lambda *a: errors(*a).norm(dim=1), "its square"),
    ("hw1.loss", lambda *a: errors(*a).abs().sum(1), "square the differences"),
    ("hw1.loss", lambda v, a, b, t: v(place(a, b, t), t).sum(1), "takes the time first"),
    ("hw1.loss", lambda v, a, b, t: (v(t, (1 - t) * a + t * b) - b + a).sum(1), "raised Runtime"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, sign=-1), "backwards"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, start=1 / n), "starts at t = 0"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, start=1.0, by=-1 / n), "time runs from 0"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, h=1 / max(n - 1, 1)), "beyond t = 1"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, steps=n - 1), "did not arrive"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, steps=n + 1), "4 steps, you took 5"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, still=True), "where you are"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, by=0.0), "t moves on"),
    ("hw1.euler", lambda v, x, n: walk(v, x, n, h=1.0, by=1 / n), "h is missing"),
    ("hw1.euler", numbers_as_times, "a tensor of times, one for each row"),
    ("hw1.euler", lambda v, x, n: [walk(v, x, n)], "must be a tensor"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, kind="equal"), "not alike"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, centre=1.0), "around t m_k"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, sign=1), "enters with a minus"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, kind="points"), "runs over the points"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, kind="exp"), "use softmax"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, kind="nearest"), "not the nearest"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, kind="flat"), "that is the mean of the m_k"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, two=1), "the 2 is missing"),
    ("hw1.exact_velocity", lambda *a: mixture(*a, of_s=1), "has a t²"),
    ("hw1.squared_w2", lambda a, b: math.sqrt(best(a, b).mean()), "no root"),
    ("hw1.squared_w2", lambda a, b: float(best(a, b).sum()), "not the total"),
    ("hw1.squared_w2", lambda a, b: float((a - b).square().sum(1).mean()), "row i need not"),
    ("hw1.squared_w2", lambda a, b: float(costs(a, b).min(1).values.mean()), "nearest neighbours"),
    ("hw1.squared_w2", lambda a, b: float(costs(a, b).mean()), "all pairs"),
    ("hw1.squared_w2", lambda a, b: float(best(a, b).sqrt().mean()), "before the mean"),
    ("hw1.squared_w2", lambda a, b: float(best(a, b).mean()) / a.shape[1], "sum over coordinates"),
    ("hw1.squared_w2", best, "return one number"),
]
