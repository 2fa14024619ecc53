"""The checks of notebook 01."""

import functools

import torch

from cotlearn.flows import integrate

from .common import Case, Cases, field_at, one_of_two, table


@table("01.interpolate")
def interpolate(g: torch.Generator) -> Cases:
    """The straight path and its velocity, with one time per row."""
    two = "return two things: the place x_t and the velocity"
    for n, d in ((5, 2), (3, 3)):  # in a square batch a forgotten t[:, None] raises nothing
        x0, x1 = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        t = torch.tensor([0.0, 1.0, 0.25, 0.5, 0.9])[:n]
        s = t[:, None]
        place = (1 - s) * x0 + s * x1
        wrong = {"the ends are swapped: at t = 0 the place is x0, the noise": s * x0 + (1 - s) * x1}
        if n == d:
            wrong["t belongs to rows: in a square batch t[:, None], not t"] = (1 - t) * x0 + t * x1
        hint = "the place is not on the line: it is (1 - t) x0 + t x1"
        read = one_of_two(0, (n, d), "the place", two)
        yield Case((x0, x1, t), place, wrong, hint, read=read)
        wrong = {
            "the velocity points backwards: the line runs from x0 to x1": x0 - x1,
            "x1 - x_t is the distance that remains; the velocity never changes": x1 - place,
            "you returned the place twice; differentiate it with respect to t": place,
        }
        hint = "differentiate (1 - t) x0 + t x1 with respect to t"
        read = one_of_two(1, (n, d), "the velocity", two)
        yield Case((x0, x1, t), x1 - x0, wrong, hint, read=read)


@table("01.velocity_from_end", seed=1)
def velocity_from_end(g: torch.Generator) -> Cases:
    """The velocity (end - x) / (1 - t), with one time per row."""
    for n, d in ((6, 2), (3, 3)):
        x, end = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        t = torch.tensor([0.2, 0.75, 0.6, 0.4, 0.9, 0.1])[:n]
        s = t[:, None]
        wrong = {
            "end - x is the distance that remains; divide it by the time that remains": end - x,
            "t is the time that has passed; divide by the time that remains": (end - x) / s,
            "this points away from the end": (x - end) / (1 - s),
            "the bracket is missing: all of end - x is divided": end - x / (1 - s),
            "less time left means more speed: divide, do not multiply": (end - x) * (1 - s),
        }
        if n == d:
            wrong["t belongs to rows: write t[:, None]"] = (end - x) / (1 - t)
        hint = "solve x = (1 - t) x0 + t x1 for x0, then form x1 - x0"
        yield Case((t, x, end), (end - x) / (1 - s), wrong, hint, "the velocity")


@table("01.midpoint")
def midpoint() -> Cases:
    """The result of nfe / 2 midpoint steps in a field that depends on t and x."""
    nfe = 8
    x0 = torch.tensor([[0.3, -0.7], [1.1, 0.2], [-0.4, 0.9]])
    walk = functools.partial(_midpoint, x0, nfe // 2)
    bought = _midpoint(x0, nfe)
    heun = integrate(lambda t, x, c: field_at(t, x), x0, nfe=nfe, method="heun").x1
    wrong = {
        f"nfe={nfe} bought {2 * nfe} evaluations; a step needs two: take nfe / 2 steps": bought,
        "this is Euler: evaluate again after half a step": _midpoint(x0, nfe, trial=0, late=0),
        "the second evaluation must be at the midpoint, not at x": walk(trial=0),
        "this is Euler with half the steps: go on to the midpoint": walk(trial=0, late=0),
        "the second evaluation is at time t + h / 2": walk(late=0),
        "try half a step, not a whole one": walk(trial=1),
        "you evaluate at the end of the step; evaluate in its middle": walk(trial=1, late=1),
        "this is Heun's rule: as accurate, but not the midpoint": heun,
        "after the trial go back: the step starts at x, not at the midpoint": walk(back=False),
    }
    hint = "one step: half = x + h/2 v(t, x), then x + h v(t + h/2, half), h = 2/nfe"
    what = "the last state (and only that)"
    yield Case((field_at, x0, nfe), walk(), wrong, hint, what, nfe=nfe)


def _midpoint(
    x: torch.Tensor, steps: int, *, trial: float = 0.5, late: float = 0.5, back: bool = True
) -> torch.Tensor:
    """The midpoint rule; the options reproduce typical mistakes (0, 0 is Euler's method)."""
    h = 1 / steps
    for k in range(steps):
        half = x + trial * h * field_at(k * h, x)
        x = (x if back else half) + h * field_at((k + late) * h, half)
    return x
