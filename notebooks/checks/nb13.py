"""The checks of notebook 13."""

import math

import torch

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


@table("13.reading")
def reading() -> Cases:
    """The way with the fewest seconds within twice the floor, of those with the given noise."""
    listed = [("E", 15.0, 1.2, True), ("C", 20.0, 1.0, True), ("F", 30.0, 0.9, True)]
    listed += [("A", 2.0, 1.1, False), ("B", 9.0, 1.8, True), ("D", 1.0, 6.0, True)]
    rows = [{"way": w, "seconds": s, "score": e, "given_noise": g} for w, s, e, g in listed]
    for floor, right in ((1.0, "B"), (0.9, "B"), (0.6, "E"), (0.4, "none")):
        wrong = {
            "that way starts from other noise than the given": "A",
            "its score is more than twice the floor": "D",
            "not the best score, but the fewest seconds among the good ones": "F",
            f"twice the floor is allowed: {right!r} is faster": "C",
            "'B' is faster, and its score at most twice the floor: compare all, with <=": "E",
            "at most twice the floor is asked for: 'B' has more": "B",
        }
        yield Case((rows, floor), right, {} if right == "none" else wrong)
