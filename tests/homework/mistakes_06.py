"""Wrong answers to the exercises of notebook 06, words of their hints, right ones."""

import torch


def newton(x, t, slope, curvature, *, stay=None, derivative=None, steps=60):
    """Solves stay(z) + t slope(z) = x, or a variant of it."""
    z = torch.zeros_like(x)
    for _ in range(steps):
        left = (1 - t) * z + t * slope(z) if stay is None else stay(z, t, slope)
        by_z = (1 - t) + t * curvature(z) if derivative is None else derivative(z, t, curvature)
        z = z - (left - x) / by_z
    return z


def whole_slope(x, t, slope, curvature):
    return newton(x, 1.0, slope, curvature)


def swapped(x, t, slope, curvature):
    return newton(x, 1 - t, slope, curvature)


def the_end(x, t, slope, curvature):
    return slope(newton(x, t, slope, curvature))


def the_velocity(x, t, slope, curvature):
    z = newton(x, t, slope, curvature)
    return slope(z) - z


def three_steps(x, t, slope, curvature):
    return newton(x, t, slope, curvature, steps=3)


def curvature_twice(x, t, slope, curvature):
    return newton(x, t, slope, curvature, derivative=lambda z, t, c: 0.1 + 0 * z)


def squares(mapped, truth):
    return (mapped - truth).square().sum(dim=1).mean()


def spread(x):
    return x.var(dim=0).sum()


def half_square(a, b, x0, x1):
    return (a * x0 + b - x1) ** 2 / 2


def gap(a, b, x0, x1):
    return half_square(a, b, x0, x1) / a


MISTAKES = [
    ("06.start_of_line", lambda x, t, slope, curvature: x, "where did it start"),
    ("06.start_of_line", the_end, "where the line ends"),
    ("06.start_of_line", the_velocity, "velocity"),
    ("06.start_of_line", whole_slope, "(1 - t) z is missing"),
    ("06.start_of_line", lambda x, t, s, c: swapped(x, t, s, c), "swapped"),
    ("06.start_of_line", three_steps, "more steps"),
    ("06.start_of_line", curvature_twice, "run away"),
    ("06.start_of_line", lambda x, t, slope, curvature: x[:2], "shape (7,)"),
    ("06.start_of_line", lambda x, t, slope, curvature: 3.0, "float"),
    ("06.uvp", lambda m, t: squares(m, t) / spread(t), "100 times"),
    ("06.uvp", lambda m, t: 100 * (m - t).square().mean() / spread(t), "sum over coordinates"),
    ("06.uvp", lambda m, t: 100 * squares(m, t) / t.var(), "sum of the variances"),
    ("06.uvp", lambda m, t: 100 * (m - t).square().mean() / t.var(), "its own mean"),
    ("06.uvp", lambda m, t: 100 * squares(m, t) / t.square().sum(1).mean(), "about the mean"),
    ("06.uvp", lambda m, t: 100 * (squares(m, t) / spread(t)) ** 0.5, "square root"),
    ("06.uvp", lambda m, t: 100 * (m - t).norm(dim=1).mean() / spread(t), "before the mean"),
    ("06.uvp", lambda m, t: 7.0, "expected"),
    ("06.uvp", lambda m, t: m - t, "one number"),
    ("06.gap", lambda a, b, x0, x1: a * x0**2 / 2 + b * x0 + (x1 - b) ** 2 / (2 * a), "subtract"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1) * 2 / a, "half of it"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1) * 2, "squared error of the map"),
    (
        "06.gap",
        lambda a, b, x0, x1: a * x0**2 / 2 + b * x0 + x1**2 / (2 * a) - x0 * x1,
        "knows b",
    ),
    (
        "06.gap",
        lambda a, b, x0, x1: a * x0**2 / 2 + b * x0 - (x1 - b) ** 2 / (2 * a) - x0 * x1,
        "its sign",
    ),
    (
        "06.gap",
        lambda a, b, x0, x1: a * (x0**2 + x1**2) / 2 + b * (x0 + x1) - x0 * x1,
        "that is Psi(x1)",
    ),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) + a * x0**2 / 2, "1/2 is missing"),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) + (x1 - b) ** 2 / (2 * a), "the 2 is"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1), "the a is missing"),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) - b * x0, "b x0 is missing"),
    ("06.gap", lambda a, b, x0, x1: 99.0, "expected"),
    ("06.gap", 3.0, "expected a function"),
]


def by_bisection(x, t, slope, curvature):
    low, high = torch.full_like(x, -50), torch.full_like(x, 50)
    for _ in range(60):
        z = (low + high) / 2
        below = (1 - t) * z + t * slope(z) < x
        low, high = torch.where(below, z, low), torch.where(below, high, z)
    return z


def n_rows(mapped, truth):
    return 100 * squares(mapped, truth) / truth.var(dim=0, unbiased=False).sum()


RIGHT = [
    ("06.start_of_line", newton),
    ("06.start_of_line", by_bisection),
    ("06.uvp", n_rows),
    ("06.gap", lambda a, b, x0, x1: torch.tensor(half_square(a, b, x0, x1) / a)),
]
