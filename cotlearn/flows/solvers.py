"""Solvers of dx/dt = v(t, x, c) from noise (t = 0) to data (t = 1) that count evaluations."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.integrate import solve_ivp
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.base import Source, draw_noise
from cotlearn.flows.matching import Velocity, evaluate

MOST_EVALUATIONS = 20_000  #: of dopri5
TOLERANCE = 1e-4  #: relative and absolute, of dopri5

Field = Callable[[float, Tensor], Tensor]


@dataclass(frozen=True)
class Solution:
    """Samples and their cost.

    Attributes:
        x1: (B, d), the samples at t = 1.
        nfe: number of evaluations of the velocity.
        times: (T,), from 0 to 1.
        trajectory: (T, B, d), the states at `times`; None unless `integrate` was asked to keep it.
    """

    x1: Tensor
    nfe: int
    times: Tensor
    trajectory: Tensor | None = None


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


#: Each method and its evaluations per step.
_STEPS = {"euler": (_euler, 1), "midpoint": (_midpoint, 2), "heun": (_heun, 2), "rk4": (_rk4, 4)}
FIXED = tuple(_STEPS)  #: with steps of a fixed size
METHODS = (*FIXED, "dopri5")


@torch.no_grad()
def integrate(
    velocity: Velocity,
    x0: Tensor,
    c: Tensor | None = None,
    *,
    nfe: int | None = None,
    method: str = "euler",
    trajectory: bool = False,
) -> Solution:
    """Integrate the velocity field from noise x0 at t = 0 to samples at t = 1.

    The samples have no gradient. For a loss of samples write the steps x = x + v / nfe yourself.

    Args:
        velocity: called as velocity(t, x, c), t a scalar tensor; returns (B, d).
        x0: (B, d), finite.
        c: (B, k), or None.
        nfe: evaluations of the velocity, for the fixed-step methods: Euler takes nfe steps,
            midpoint and Heun nfe / 2, the classical Runge-Kutta method nfe / 4.
        method: "euler", "midpoint", "heun", "rk4"; or "dopri5", adaptive (SciPy's RK45), which
            chooses its steps by the error over the whole batch, with a relative
            and an absolute tolerance of 1e-4: for values near 1, as standard normal noise.
        trajectory: keep the states after every step.

    Returns:
        A `Solution`: x1 (B, d), nfe, times and, if asked for, the trajectory.

    Raises:
        TypeError: x0, c or the velocity is not a floating-point tensor.
        ValueError: nfe is missing, below 1, not divisible as the method needs, or given with
            dopri5; the method is unknown; x0, c or the velocity has a wrong shape; x0 or c is not
            finite; the velocity is a network in train mode, or holds one, that has dropout or
            normalises by its batch.
        RuntimeError: the samples are not finite; with dopri5, the velocity is not, the step size
            became too small, or 20,000 evaluations were not enough.
    """
    validation.check_function(velocity, "velocity", "(t, x, c) -> v")
    validation.check_sampled(velocity, x0, c, of="velocity")
    evaluations = 0

    def field(t: float, x: Tensor) -> Tensor:
        nonlocal evaluations
        evaluations += 1
        if evaluations > MOST_EVALUATIONS and method == "dopri5":
            raise RuntimeError(
                f"dopri5 stopped at t = {t:.4g} after {MOST_EVALUATIONS} evaluations: the field is "
                "stiff there; use a method with fixed steps"
            )
        time = torch.tensor(t, dtype=x0.dtype, device=x.device)
        return evaluate(velocity, time, x.to(x0.dtype), c)

    if validation.check_choice(method, "method", METHODS) == "dopri5":
        if nfe is not None:
            raise ValueError(f"nfe must be None for dopri5, which chooses its steps, got {nfe}")
        times, states = _adaptive(field, x0)
    else:
        if nfe is None:
            raise ValueError(f"nfe is missing: how many evaluations may {method} make?")
        one_step, per_step = _STEPS[method]
        steps, rest = divmod(validation.check_count(nfe, "nfe"), per_step)
        if rest:
            raise ValueError(f"nfe must be divisible by {per_step} for {method}, got {nfe}")
        wide = torch.promote_types(x0.dtype, torch.float32)  # small steps would be rounded away
        times, states = torch.arange(steps + 1) / steps, [x0.to(wide)]
        for step in range(steps):
            after = one_step(field, step / steps, 1 / steps, states[-1])
            states = [*states, after] if trajectory else [after]
        states = [state.to(x0.dtype) for state in states]
        _check_end(states[-1], f"{method} with nfe={nfe}")
    return Solution(states[-1], evaluations, times, torch.stack(states) if trajectory else None)


def _check_end(x: Tensor, how: str) -> None:
    """Raise RuntimeError unless the samples x (B, d) are finite."""
    if math.isfinite(x.sum()):  # quick; large finite numbers can overflow, too
        return
    lost = int((~torch.isfinite(x)).any(dim=1).sum())
    if lost:
        raise RuntimeError(
            f"{how} ended with NaN or infinite values in {lost} of {len(x)} rows: the velocity is "
            "not finite, or grows faster than these steps can follow"
        )


def _adaptive(field: Field, x0: Tensor) -> tuple[Tensor, list[Tensor]]:
    def tensor(flat: Any) -> Tensor:
        return torch.as_tensor(flat, dtype=x0.dtype, device=x0.device).reshape(x0.shape)

    def derivative(t: float, flat: Any) -> Any:
        v = field(t, tensor(flat)).reshape(-1).to("cpu", torch.float64)
        if not torch.isfinite(v).all():  # SciPy would look for a step size for ever
            raise RuntimeError(f"dopri5 stopped at t = {t:.4g}: the velocity is not finite")
        return v.numpy()

    start = x0.reshape(-1).to("cpu", torch.float64).numpy()
    with np.errstate(all="ignore"):
        solved = solve_ivp(derivative, (0.0, 1.0), start, "RK45", rtol=TOLERANCE, atol=TOLERANCE)
    if not solved.success:
        raise RuntimeError(f"dopri5 stopped at t = {solved.t[-1]:.4g}: {solved.message}")
    return torch.from_numpy(solved.t), [tensor(y) for y in solved.y.T]


def sampler(
    velocity: Velocity, *, nfe: int, dim: int | None = None, source: Source | None = None
) -> Callable[..., Tensor]:
    """Make a function (c, generator=None) -> samples that takes Euler steps from fresh noise.

    Args:
        velocity: the velocity field, called as velocity(t, x, c).
        nfe: Euler steps.
        dim: d; may be None if the velocity has an attribute `dim`.
        source: draws the noise, `source(n, generator=g)`: that of the training; standard normal if
            None.

    Returns:
        A function from c (n, k) to one sample per row, (n, d).

    Raises:
        ValueError: dim is missing; when sampling, as `integrate`.
    """
    validation.check_function(velocity, "velocity", "(t, x, c) -> v")
    validation.check_count(nfe, "nfe")
    if source is not None:
        validation.check_function(source, "source", "(n, generator) -> x0")
    size = getattr(velocity, "dim", None) if dim is None else validation.check_count(dim, "dim")
    if size is None:
        raise ValueError("dim is missing: the velocity has no attribute dim")

    def sample(c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        validation.check_generator(generator)
        like = torch.empty(len(validation.check_condition(c)), size, dtype=_dtype_of(velocity))
        noise = draw_noise(like, source, generator)
        return integrate(velocity, noise.to(c.device), c, nfe=nfe).x1

    return sample


def _dtype_of(velocity: Velocity) -> torch.dtype:
    """The type of the weights of a network, or of one that this holds; torch's default if none."""
    held = [velocity, *getattr(velocity, "__dict__", {}).values()]
    networks = (network for part in held for network in validation.networks_in(part))
    weights = (weight for network in networks for weight in network.parameters())
    return next((w.dtype for w in weights if w.is_floating_point()), torch.get_default_dtype())
