"""Wrong answers to the exercises of notebook 06, words of their hints, right ones."""

import torch


def newton(x, t, slope, curvature, *, derivative=None, steps=60, without_t=False):
    """Solves (1 - t) z + t slope(z) = x, with the derivative by z or with another number."""
    z = torch.zeros_like(x)
    for _ in range(steps):
        by_z = (1 - t) + t * curvature(z) if derivative is None else derivative
        by_z = curvature(z) if without_t else by_z
        z = z - ((1 - t) * z + t * slope(z) - x) / by_z
    return z


def squares(mapped, truth):
    return (mapped - truth).square().sum(dim=1).mean()


def spread(x):
    return x.var(dim=0).sum()


def half_square(a, b, x0, x1):
    return (a * x0 + b - x1) ** 2 / 2


def gap(a, b, x0, x1):
    return half_square(a, b, x0, x1) / a


def psi(a, b, x):
    return a * x**2 / 2 + b * x


def conjugate(a, b, x):
    return (x - b) ** 2 / (2 * a)


MISTAKES = [
    ("06.start_of_line", lambda x, t, slope, curvature: x, "where did it start"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, t, s, c, steps=1), "one Newton step"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, t, s, c, without_t=True), "run away"),
    ("06.start_of_line", lambda x, t, s, c: s(newton(x, t, s, c)), "where the line ends"),
    ("06.start_of_line", lambda x, t, s, c: s(newton(x, t, s, c)) - newton(x, t, s, c), "velocity"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, 1.0, s, c), "(1 - t) z is missing"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, 1 - t, s, c), "swapped"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, t, s, c, steps=3), "more steps"),
    ("06.start_of_line", lambda x, t, s, c: newton(x, t, s, c, derivative=0.1), "run away"),
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
    ("06.gap", lambda a, b, x0, x1: psi(a, b, x0) + conjugate(a, b, x1), "subtract"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1) * 2 / a, "half of it"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1) * 2, "squared error of the map"),
    ("06.gap", lambda a, b, x0, x1: psi(a, b, x0) + conjugate(a, 0, x1) - x0 * x1, "knows b"),
    ("06.gap", lambda a, b, x0, x1: psi(a, b, x0) - conjugate(a, b, x1) - x0 * x1, "its sign"),
    ("06.gap", lambda a, b, x0, x1: psi(a, b, x0) + psi(a, b, x1) - x0 * x1, "that is Psi(x1)"),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) + psi(a, 0, x0), "1/2 is missing"),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) + conjugate(a, b, x1), "the 2 is"),
    ("06.gap", lambda a, b, x0, x1: half_square(a, b, x0, x1), "the a is missing"),
    ("06.gap", lambda a, b, x0, x1: psi(a, b, x0) + (x1 - b) ** 2 - x0 * x1, "the 2 a is missing"),
    ("06.gap", lambda a, b, x0, x1: gap(a, b, x0, x1) - b * x0, "b x0 is missing"),
    ("06.gap", lambda a, b, x0, x1: 99.0, "expected"),
    ("06.gap", 3.0, "expected a function"),
    ("06.action", lambda a, t, x: (a - 1) * x / (1 - t + t * a), "that is the velocity"),
    ("06.action", lambda a, t, x: x**2 / 2 - x**2 / (2 - 2 * t + 2 * t * a), "Phi_t* by t"),
    ("06.action", lambda a, t, x: (a - 1) * x**2 / (2 * (t + (1 - t) * a)), "swapped"),
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
