"""The checks of notebook 01."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from cotlearn.homework.checks.common import expect_function
from cotlearn.homework.registry import NotYet, exercise


@exercise("01.interpolate")
def interpolate(answer: Any) -> None:
    """The straight path and its velocity, with one time for each row."""
    expect_function(answer)
    g = torch.Generator().manual_seed(0)
    for n, d in ((5, 2), (3, 3)):  # in a square batch a forgotten t[:, None] raises nothing
        x0, x1 = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        t = torch.tensor([0.0, 1.0, 0.25, 0.5, 0.9])[:n]
        got = answer(x0.clone(), x1.clone(), t.clone())
        if not isinstance(got, tuple | list) or len(got) != 2:
            raise NotYet("return two things: the place x_t and the velocity")
        place, velocity = got
        _expect_shape(place, "the place", n, d)
        _expect_shape(velocity, "the velocity", n, d)
        s = t[:, None]
        right = (1 - s) * x0 + s * x1
        if _same(place, s * x0 + (1 - s) * x1):
            raise NotYet("the ends are swapped: at t = 0 the place is x0, the noise")
        if n == d and _same(place, (1 - t) * x0 + t * x1):
            raise NotYet("t belongs to rows: in a square batch t without [:, None] meets columns")
        if not _same(place, right):
            raise NotYet("the place is not on the line: it is (1 - t) x0 + t x1")
        if _same(velocity, x0 - x1):
            raise NotYet("the velocity points backwards: the line runs from x0 to x1")
        if _same(velocity, x1 - right):
            raise NotYet("x1 - x_t is the way that is left; the speed is the same all the way")
        if _same(velocity, right):
            raise NotYet("you returned the place twice; differentiate it with respect to t")
        if not _same(velocity, x1 - x0):
            raise NotYet("differentiate (1 - t) x0 + t x1 with respect to t")


@exercise("01.velocity_from_end")
def velocity_from_end(answer: Any) -> None:
    """(end - x) / (1 - t), with one time for each row."""
    expect_function(answer)
    g = torch.Generator().manual_seed(1)
    for n, d in ((6, 2), (3, 3)):
        x, end = torch.randn(n, d, generator=g), torch.randn(n, d, generator=g)
        t = torch.tensor([0.2, 0.75, 0.6, 0.4, 0.9, 0.1])[:n]
        got = answer(t.clone(), x.clone(), end.clone())
        _expect_shape(got, "the velocity", n, d)
        s = t[:, None]
        hints = [
            (end - x, "end - x is the way that is left; divide it by the time that is left"),
            ((end - x) / s, "t is the time that has passed; divide by the time that is left"),
            ((x - end) / (1 - s), "this points away from the end"),
            (end - x / (1 - s), "the bracket is missing: all of end - x is divided"),
            ((end - x) * (1 - s), "less time left means more speed: divide, do not multiply"),
        ]
        for wrong, hint in hints:
            if _same(got, wrong):
                raise NotYet(hint)
        if n == d and _same(got, (end - x) / (1 - t)):
            raise NotYet("t belongs to rows: write t[:, None]")
        if not _same(got, (end - x) / (1 - s)):
            raise NotYet("solve x = (1 - t) x0 + t x1 for x0, then form x1 - x0")


@exercise("01.midpoint")
def midpoint(answer: Any) -> None:
    """nfe / 2 midpoint steps of a field that depends on t and x."""
    expect_function(answer)
    calls = 0

    def velocity(t: Any, x: Tensor) -> Tensor:
        nonlocal calls
        calls += 1
        t = torch.as_tensor(t)
        return torch.cos(3 * x) + 2 * (t[:, None] if t.ndim == 1 else t) * x

    x0 = torch.tensor([[0.3, -0.7], [1.1, 0.2], [-0.4, 0.9]])
    nfe = 8
    got = answer(velocity, x0.clone(), nfe)
    made = calls
    _expect_shape(got, "the states at t = 1", *x0.shape, note=" (only the last state)")
    if _same(got, _midpoint(velocity, x0, nfe)):
        raise NotYet(
            f"nfe={nfe} bought {made} evaluations; a step needs two, so take nfe / 2 steps"
        )
    hints = [
        (_euler(velocity, x0, nfe), "this is Euler: look again after half a step"),
        (_euler(velocity, x0, nfe // 2), "the second look must be at the midpoint, not at x"),
        (_midpoint(velocity, x0, nfe // 2, late=0.0), "the second look is at time t + h / 2"),
        (_midpoint(velocity, x0, nfe // 2, trial=1.0), "try half a step, not a whole one"),
        (
            _midpoint(velocity, x0, nfe // 2, trial=1.0, late=1.0),
            "you look at the end of the step; look in its middle",
        ),
        (_heun(velocity, x0, nfe // 2), "this is Heun's rule: as accurate, but not the midpoint"),
        (
            _midpoint(velocity, x0, nfe // 2, back=False),
            "after the trial go back: the whole step starts at x, not at the midpoint",
        ),
    ]
    for wrong, hint in hints:
        if _same(got, wrong):
            raise NotYet(hint)
    if made != nfe:
        raise NotYet(f"nfe={nfe} must evaluate the velocity {nfe} times, not {made}")
    if not _same(got, _midpoint(velocity, x0, nfe // 2)):
        raise NotYet("one step: half = x + h/2 v(t, x), then x + h v(t + h/2, half), h = 2/nfe")


def _euler(velocity: Any, x: Tensor, steps: int) -> Tensor:
    for k in range(steps):
        x = x + velocity(k / steps, x) / steps
    return x


def _heun(velocity: Any, x: Tensor, steps: int) -> Tensor:
    h = 1 / steps
    for k in range(steps):
        first = velocity(k * h, x)
        x = x + h / 2 * (first + velocity((k + 1) * h, x + h * first))
    return x


def _midpoint(
    velocity: Any,
    x: Tensor,
    steps: int,
    *,
    trial: float = 0.5,
    late: float = 0.5,
    back: bool = True,
) -> Tensor:
    """The rule, and with other options the mistakes one can make in it."""
    h = 1 / steps
    for k in range(steps):
        half = x + trial * h * velocity(k * h, x)
        x = (x if back else half) + h * velocity((k + late) * h, half)
    return x


def _expect_shape(value: Any, name: str, n: int, d: int, *, note: str = "") -> None:
    got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
    if got != (n, d):
        raise NotYet(f"{name} must be a tensor of shape ({n}, {d}){note}, got {got}")


def _same(a: Tensor, b: Tensor) -> bool:
    return torch.allclose(a.to(b.dtype), b, atol=1e-4)
