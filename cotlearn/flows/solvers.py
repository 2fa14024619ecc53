"""Solvers of dx/dt = v(t, x, c) from noise (t = 0) to data (t = 1), counting evaluations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from cotlearn.couplings.base import Source
from cotlearn.flows.matching import Velocity
from cotlearn.validation import (
    check_choice,
    check_condition,
    check_count,
    check_matrix,
    check_number,
    check_same_rows,
)

METHODS = ("euler", "midpoint", "heun", "rk4", "dopri5")
EVALUATIONS = {"euler": 1, "midpoint": 2, "heun": 2, "rk4": 4}  #: of one step

Field = Callable[[float, Tensor], Tensor]


@dataclass(frozen=True)
class Solution:
    """Samples and what they cost.

    Attributes:
        x1: (B, d), the samples at t = 1.
        nfe: evaluations of the velocity that were made.
        times: (T,), from 0 to 1.
        trajectory: (T, B, d), the states at `times`; None unless asked for.
    """

    x1: Tensor
    nfe: int
    times: Tensor
    trajectory: Tensor | None = None


class _Counted:
    """The velocity with its condition put in and its evaluations counted."""

    def __init__(self, velocity: Velocity, c: Tensor | None) -> None:
        self.velocity, self.c, self.nfe = velocity, c, 0

    def __call__(self, t: float, x: Tensor) -> Tensor:
        self.nfe += 1
        v = self.velocity(torch.tensor(t, dtype=x.dtype, device=x.device), x, self.c)
        if not isinstance(v, Tensor) or v.shape != x.shape:
            got = tuple(v.shape) if isinstance(v, Tensor) else type(v).__name__
            raise ValueError(f"velocity must return shape {tuple(x.shape)}, got {got}")
        return v


def _euler(field: Field, t: float, h: float, x: Tensor) -> Tensor:
    return x + h * field(t, x)


def _midpoint(field: Field, t: float, h: float, x: Tensor) -> Tensor:
    return x + h * field(t + h / 2, x + h / 2 * field(t, x))


def _heun(field: Field, t: float, h: float, x: Tensor) -> Tensor:
    k1 = field(t, x)
    return x + h / 2 * (k1 + field(t + h, x + h * k1))


def _rk4(field: Field, t: float, h: float, x: Tensor) -> Tensor:
    k1 = field(t, x)
    k2 = field(t + h / 2, x + h / 2 * k1)
    k3 = field(t + h / 2, x + h / 2 * k2)
    k4 = field(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


_STEPS = {"euler": _euler, "midpoint": _midpoint, "heun": _heun, "rk4": _rk4}


@torch.no_grad()
def integrate(
    velocity: Velocity,
    x0: Tensor,
    c: Tensor | None = None,
    *,
    nfe: int | None = None,
    method: str = "euler",
    trajectory: bool = False,
    rtol: float | None = None,
    atol: float | None = None,
) -> Solution:
    """Carry noise x0 along the velocity to t = 1.

    Args:
        velocity: called as velocity(t, x, c) with t a scalar tensor.
        x0: (B, d), finite.
        c: (B, k), or None.
        nfe: evaluations of the velocity, for the fixed-step methods: Euler makes nfe steps,
            midpoint and Heun nfe / 2, the classical Runge-Kutta method nfe / 4.
        method: "euler", "midpoint", "heun", "rk4"; or "dopri5", adaptive (SciPy's RK45), which
            takes tolerances instead of nfe and steers by the error over the whole batch.
        trajectory: keep the states after every step.
        rtol: relative tolerance of dopri5 (default 1e-4).
        atol: absolute tolerance of dopri5 (default 1e-4).

    Raises:
        ValueError: nfe missing, below 1, not divisible for the method, or given with dopri5;
            tolerances given with a fixed-step method; an unknown method; shapes or values off.
        RuntimeError: dopri5 met a velocity that is not finite, or needs steps too small.
    """
    check_matrix(x0, "x0")
    if c is not None:
        check_same_rows(check_condition(c), "c", x0, "x0")
    check_choice(method, "method", METHODS)
    field = _Counted(velocity, c)
    if method == "dopri5":
        if nfe is not None:
            raise ValueError(f"nfe={nfe} was given with dopri5, which takes rtol and atol instead")
        times, states = _adaptive(field, x0, _tolerance(rtol, "rtol"), _tolerance(atol, "atol"))
    else:
        if rtol is not None or atol is not None:
            raise ValueError(f"rtol and atol belong to dopri5; {method} takes nfe")
        times, states = _fixed(field, x0, method, _steps(nfe, method), trajectory)
    return Solution(states[-1], field.nfe, times, torch.stack(states) if trajectory else None)


def _steps(nfe: Any, method: str) -> int:
    per_step = EVALUATIONS[method]
    if nfe is None:
        raise ValueError(f"nfe is missing: how many evaluations may {method} make?")
    if check_count(nfe, "nfe") % per_step:
        raise ValueError(f"nfe must be divisible by {per_step} for {method}, got {nfe}")
    return int(nfe) // per_step


def _tolerance(value: float | None, name: str) -> float:
    if value is None:
        return 1e-4
    if check_number(value, name) == 0:
        raise ValueError(f"{name} must be above 0, got {value}")
    return float(value)


def _fixed(
    field: Field, x: Tensor, method: str, steps: int, keep: bool
) -> tuple[Tensor, list[Tensor]]:
    states = [x]
    for step in range(steps):
        x = _STEPS[method](field, step / steps, 1 / steps, x)
        states = [*states, x] if keep else [x]
    return torch.arange(steps + 1) / steps, states


def _adaptive(field: Field, x0: Tensor, rtol: float, atol: float) -> tuple[Tensor, list[Tensor]]:
    def tensor(flat: Any) -> Tensor:
        return torch.as_tensor(flat, dtype=x0.dtype, device=x0.device).reshape(x0.shape)

    def derivative(t: float, flat: Any) -> Any:
        v = field(t, tensor(flat)).reshape(-1).to("cpu", torch.float64)
        if not torch.isfinite(v).all():  # SciPy would look for a step size for ever
            raise RuntimeError(f"dopri5 stopped at t = {t:.4g}: the velocity is not finite")
        return v.numpy()

    start = x0.reshape(-1).to("cpu", torch.float64).numpy()
    with np.errstate(all="ignore"):
        solved = solve_ivp(derivative, (0.0, 1.0), start, method="RK45", rtol=rtol, atol=atol)
    if not solved.success:
        raise RuntimeError(f"dopri5 stopped at t = {solved.t[-1]:.4g}: {solved.message}")
    return torch.from_numpy(solved.t), [tensor(y) for y in solved.y.T]


class ConditionalSampler(Protocol):
    """Draws one sample for each row of c: `sample(c, generator=g)` of shape (n, d)."""

    def __call__(self, c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw the samples."""
        ...


def sampler(
    velocity: Velocity,
    *,
    nfe: int | None = None,
    method: str = "euler",
    source: Source | None = None,
    dim: int | None = None,
) -> ConditionalSampler:
    """A function (c, generator) -> samples: fresh noise for each row of c, then `integrate`.

    Args:
        velocity: the field.
        nfe: as in `integrate`.
        method: as in `integrate`.
        source: draws the noise; standard normal if None.
        dim: d, needed for a velocity without an attribute `dim` unless a source is given.
    """
    size = getattr(velocity, "dim", None) if dim is None else check_count(dim, "dim")
    if size is None and source is None:
        raise ValueError("dim is missing: the velocity does not say its dimension")

    def sample(c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        check_condition(c)
        if source is not None:
            noise = source(len(c), generator=generator).to(c.device)
        else:
            noise = torch.randn(len(c), int(size or 0), generator=generator).to(c.device)
        return integrate(velocity, noise, c, nfe=nfe, method=method).x1

    return sample
