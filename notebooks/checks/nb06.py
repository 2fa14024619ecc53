"""The checks of notebook 06 and of its laboratory."""

from collections.abc import Callable
from typing import Any

import torch

from .common import Case, Cases, same, squares, table, tensor

Function = Callable[[torch.Tensor], torch.Tensor]
#: slope and curvature of convex functions of one variable
CONVEX: tuple[tuple[Function, Function], ...] = (
    (lambda z: 0.25 * z + 1, lambda z: torch.full_like(z, 0.25)),
    (lambda z: z + z**3, lambda z: 1 + 3 * z**2),
    (lambda z: 0.5 * z + torch.tanh(z), lambda z: 1.5 - torch.tanh(z) ** 2),
)


@table("06.start_of_line")
def start_of_line() -> Cases:
    """The solution z of (1 - t) z + t slope(z) = x, to four digits."""
    for t in (0.5, 0.3, 1.0, 0.0):
        for slope, curvature in CONVEX:
            yield line_start(torch.linspace(-1.5, 1.5, 7), t, slope, curvature)


def line_start(z: torch.Tensor, t: float, slope: Function, curvature: Any) -> Case:
    """A case for the start z of the line through x at time t: (1 - t) z + t slope(z) = x."""

    def left(z: torch.Tensor, t: float = t) -> torch.Tensor:
        return (1 - t) * z + t * slope(z)

    def read(value: Any) -> torch.Tensor:
        value = value.nan_to_num(1e9) if isinstance(value, torch.Tensor) else value
        return tensor(value, tuple(z.shape), "z, like x,")

    def otherwise(found: torch.Tensor) -> str:
        off = float((left(found) - x).abs().max())
        newton = "divide by the derivative of the left side, (1 - t) + t curvature(z)"
        if not off <= 1:
            return f"the steps run away: look at the sign of the step, and {newton}"
        return f"at t = {t} the two sides still differ by {off:.2g}: take more steps, and {newton}"

    x = left(z)
    wrong = {
        "that is x itself, or one Newton step from 0: where did it start?": x,
        "that is slope(z), where the line ends; return z": slope(z),
        "that is the velocity slope(z) - z; return z": slope(z) - z,
        "the (1 - t) z is missing: you solved slope(z) = x": lambda found: same(slope(found), x),
        "t and 1 - t are swapped": lambda found: same(left(found, 1 - t), x),
        "that goes forward; the z that leads to x is asked for": slope(x),
        "that goes forward, from z to x; solve the equation for z": left(x),
    }
    return Case((x, t, slope, curvature), z, wrong, otherwise, read=read, tolerance=1e-3)


@table("06.uvp", seed=6)
def uvp(g: torch.Generator) -> Cases:
    """L2-UVP in percent: 100 E|T - T*|^2 / Var, where Var is the trace of T*'s covariance."""
    for d in (2, 5):
        truth = torch.randn(40, d, generator=g) * torch.arange(1, d + 1) + 3 * torch.arange(d)
        mapped = truth + 0.7 * torch.randn(40, d, generator=g)
        off = mapped - truth
        error, var, own = off.square().sum(1).mean(), truth.var(0).sum(), mapped.var(0).sum()
        per_axis = 100 * error / d / truth.var()
        about_zero = 100 * error / truth.square().sum(1).mean()
        wrong = squares(off, 100 / var) | {
            "in percent: 100 times that": error / var,
            "each coordinate varies about its own mean: var(dim=0), then the sum": per_axis,
            "Var is the sum of the variances of the coordinates": 100 * error / truth.var(),
            "Var is about the mean: E|x|^2 - |E x|^2": about_zero,
            "divide by the variance of the truth, not of your own map": 100 * error / own,
            "no square root: it is a ratio of squares": 100 * (error / var).sqrt(),
        }
        biased = 100 * error / truth.var(0, correction=0).sum()  # n for n - 1 will do
        hint = f"for a map with {d} coordinates expected {100 * error / var:.2f}"
        yield Case((mapped, truth), 100 * error / var, wrong, hint, also=(biased,))


@table("06.gap")
def gap() -> Cases:
    """The Fenchel-Young gap (a x0 + b - x1)^2/(2 a) of Psi(x) = a x^2/2 + b x."""
    for a, b, x0, x1 in ((2.3, 1.1, 0.7, 3.4), (0.6, -1.3, 1.9, 1.2), (3.0, 0.0, -1.0, 2.0)):
        psi, conjugate, product = a * x0**2 / 2 + b * x0, (x1 - b) ** 2 / (2 * a), x0 * x1
        psi_at_x1 = a * x1**2 / 2 + b * x1
        right = psi + conjugate - product
        wrong = {
            "subtract x0 x1": psi + conjugate,
            "that is the loss; the gap is half of it": 2 * right,
            "that is the squared error of the map; the gap divides it by 2 a": 2 * a * right,
            "the conjugate knows b: its z solves a z + b = x1": psi + x1**2 / (2 * a) - product,
            "Psi* is <x1, z> - Psi(z): look at its sign": psi - conjugate - product,
            "that is Psi(x1), not Psi*(x1)": psi + psi_at_x1 - product,
            "Psi(x0) has a x0^2 / 2: a factor 1/2 is missing": right + a * x0**2 / 2,
            "Psi* = (x1 - b)^2 / (2 a): the 2 is missing": right + conjugate,
            "Psi* = (x1 - b)^2 / (2 a): the a is missing": right + (a - 1) * conjugate,
            "Psi* = (x1 - b)^2 / (2 a): the 2 a is missing": right + (2 * a - 1) * conjugate,
            "Psi* = (x1 - b)^2 / (2 a): divide by a": right + (a**2 - 1) * conjugate,
            "b x0 is missing in Psi(x0)": right - b * x0,
            "divide the square by 2 a: the a is missing": a * right,
            "x0 x1 is subtracted": psi + conjugate + product,
        }
        yield Case((a, b, x0, x1), right, wrong, tolerance=1e-5)


@table("06.action")
def action() -> Cases:
    """s_t(x) = x^2 / (2 t) - Phi_t*(x) / t for Psi(x) = a x^2 / 2."""
    for a, t, x in ((2.5, 0.3, 1.4), (0.4, 0.7, -2.0), (3.0, 0.5, 0.6)):
        here, start = x**2 / (2 * t), 1 - t + t * a
        right = here - here / start
        wrong = {
            "that is the velocity, the slope of s": (a - 1) * x / start,
            "the slope of s must be the velocity: a factor 1/2 is missing": 2 * right,
            "look at the sign: the conjugate is subtracted": -right,
            "that is Phi_t*(x): subtract it from |x|^2 / 2, and divide by t": t * here / start,
            "divide Phi_t* by t": here - t * here / start,
            "divide |x|^2 / 2 and Phi_t* by t": t * right,
            "the conjugate of D z^2 / 2 is x^2 / (2 D)": here * (1 - start),
            "t and 1 - t are swapped": (a - 1) * x**2 / (2 * (t + (1 - t) * a)),
        }
        yield Case((a, t, x), right, wrong, tolerance=1e-5)
