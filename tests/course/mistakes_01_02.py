"""Wrong answers to the exercises of notebooks 01 and 02, words of their hints, right ones."""

import math

import torch
from scipy.optimize import linear_sum_assignment
from torch import cdist


def in_place(x0, x1, t):
    x0 += t[:, None] * (x1 - x0)
    return x0, x1


def columns(cost):
    return torch.from_numpy(linear_sum_assignment(cost)[1])


def line(change_place=None, change_velocity=None):
    """A right answer to 01.interpolate, with one part replaced."""

    def answer(x0, x1, t):
        t = t[:, None]
        place = (1 - t) * x0 + t * x1
        wrong = change_velocity(x0, x1, place) if change_velocity else x1 - x0
        return (change_place(x0, x1, t) if change_place else place), wrong

    return answer


def right_look(t, x, h, first):
    return x + h / 2 * first, t + h / 2


def look_at_the_end(t, x, h, first):
    return x + h * first, t + h


def middle(x, half, h, first, second):
    return x + h * second


def rule(second_look=right_look, whole=middle, per_step=2, time=torch.tensor):
    """A midpoint rule with its parts to choose, which gives the time in the form of `time`."""

    def answer(velocity, x0, nfe):
        x, steps = x0, nfe // per_step
        for k in range(steps):
            t, h = time(k / steps), 1 / steps
            first = velocity(t, x)
            half, late = second_look(t, x, h, first)
            x = whole(x, half, h, first, velocity(late, half))
        return x

    return answer


def euler(velocity, x0, nfe):
    for k in range(nfe):
        x0 = x0 + velocity(torch.tensor(k / nfe), x0) / nfe
    return x0


def greedy(x0, x1):
    cost, p = cdist(x0, x1), []
    for row in cost:
        p.append(int(row.argmin()))
        cost[:, p[-1]] = math.inf
    return p


def squares(x0, x1, p):
    return (x0 - x1[p]).square()


MISTAKES = [
    ("01.interpolate", line(lambda x0, x1, t: t * x0 + (1 - t) * x1), "swapped"),
    ("01.interpolate", line(lambda x0, x1, t: x0 + t * x1), "not on the line"),
    ("01.interpolate", line(None, lambda x0, x1, place: x0 - x1), "backwards"),
    ("01.interpolate", line(None, lambda x0, x1, place: x1 - place), "the distance that remains"),
    ("01.interpolate", line(None, lambda x0, x1, place: place), "twice"),
    ("01.interpolate", line(None, lambda x0, x1, place: x1), "differentiate"),
    ("01.interpolate", lambda x0, x1, t: ((1 - t) * x0 + t * x1, x1 - x0), "RuntimeError"),
    ("01.interpolate", lambda x0, x1, t: x1 - x0, "two things"),
    ("01.interpolate", lambda x0, x1, t: (x0[:2], x1), "shape"),
    ("01.interpolate", in_place, "changed its inputs"),
    ("01.interpolate", lambda x0, x1, t: print(end=""), "is a return missing?"),
    ("01.interpolate", 3, "function"),
    ("01.velocity_from_end", lambda t, x, end: end - x, "time that remains"),
    ("01.velocity_from_end", lambda t, x, end: (end - x) / t[:, None], "has passed"),
    ("01.velocity_from_end", lambda t, x, end: (x - end) / (1 - t[:, None]), "away"),
    ("01.velocity_from_end", lambda t, x, end: end - x / (1 - t[:, None]), "bracket"),
    ("01.velocity_from_end", lambda t, x, end: (end - x) * (1 - t[:, None]), "divide"),
    ("01.velocity_from_end", lambda t, x, end: (end - x) / (1 - t), "RuntimeError"),
    ("01.velocity_from_end", lambda t, x, end: end, "solve"),
    ("01.midpoint", euler, "this is Euler"),
    ("01.midpoint", rule(per_step=1), "bought 16"),
    ("01.midpoint", rule(lambda t, x, h, v: (x + h / 2 * v, t)), "t + h / 2"),
    ("01.midpoint", rule(lambda t, x, h, v: (x + h * v, t + h / 2)), "half a step"),
    ("01.midpoint", rule(look_at_the_end), "in its middle"),
    ("01.midpoint", rule(lambda t, x, h, v: (x, t + h / 2)), "not at x"),
    ("01.midpoint", rule(right_look, lambda x, half, h, a, b: half + h * b), "go back"),
    ("01.midpoint", rule(look_at_the_end, lambda x, half, h, a, b: x + h / 2 * (a + b)), "Heun"),
    ("01.midpoint", lambda v, x0, nfe: x0.expand(nfe + 1, *x0.shape), "and only that"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0, x1, p).sum(), "total"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0, x1, p).mean(), "sum over coordinates"),
    ("02.transport_cost", lambda x0, x1, p: (x0 - x1[p]).norm(dim=1).mean(), "distances"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0[p], x1, ...).sum(1).mean(), "belongs to x1"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0, x1, ...).sum(1).mean(), "not used"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0, x1, p).sum(1), "one number"),
    ("02.transport_cost", lambda x0, x1, p: squares(x0, x1, p).sum() / 6, "expected"),
    ("02.transport_cost", lambda x0, x1, p: 7, "for these data expected"),
    ("02.cheapest_pairing", lambda x0, x1: cdist(x0, x1).argmin(dim=1), "not a permutation"),
    ("02.cheapest_pairing", greedy, "greedy"),
    ("02.cheapest_pairing", lambda x0, x1: columns(cdist(x0, x1)), "squared distance"),
    ("02.cheapest_pairing", lambda x0, x1: columns(cdist(x1, x0) ** 2), "inverse"),
    ("02.cheapest_pairing", lambda x0, x1: columns(-(cdist(x0, x1) ** 2)), "most expensive"),
    ("02.cheapest_pairing", lambda x0, x1: torch.arange(len(x0)), "costs"),
    ("02.cheapest_pairing", lambda *x: linear_sum_assignment(cdist(*x) ** 2), "only the columns"),
    ("02.cheapest_pairing", lambda x0, x1: x1, "integers"),
    ("02.lost_share", lambda B: 1 / math.e, "limit"),
    ("02.lost_share", lambda B: 1 - (1 - 1 / B) ** B, "left out"),
    ("02.lost_share", lambda B: 1 - 1 / B, "one draw"),
    ("02.lost_share", lambda B: B * (1 - 1 / B) ** B, "divide by B"),
    ("02.lost_share", lambda B: 0.3, "what probability"),
    ("02.lost_share", lambda B: "a third", "one number"),
]


RIGHT = [
    ("02.cheapest_pairing", lambda x0, x1: columns(cdist(x0, x1) ** 2).tolist()),
    ("01.midpoint", rule(time=float)),
    ("01.midpoint", rule(time=torch.tensor)),
    ("01.midpoint", rule(time=lambda t: torch.full((3,), t))),
]
