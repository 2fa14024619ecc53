"""Solve (1 - t) z + t grad Psi(z; c) = y for z by batched, damped Newton, without gradients."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.potentials.convex import ConvexPotential, Given
from cotlearn.validation import check_has, check_inputs, check_times

EXPLICIT = 40  #: dimensions up to which full Hessians are cheaper than conjugate gradients
TOLERANCE = {torch.float64: 1e-10}  #: of |residual| / (1 + |y|); 1e-4 in other dtypes
SHORTEST = 1e-6  #: smallest share of a Newton step that is tried
MOST = 200  #: most evaluations of the gradient


class InversionWarning(RuntimeWarning):
    """Some rows of an inversion did not converge."""


@dataclass(frozen=True)
class Inversion:
    """The result of an inversion.

    Attributes:
        z: (B, d), the solution of (1 - t) z + t grad Psi(z; c) = y, or the solver's last iterate.
        residual: (B,), |(1 - t) z + t grad Psi(z; c) - y|.
        converged: (B,), whether the residual is at most the tolerance.
        evaluations: number of evaluations of the gradient.
    """

    z: Tensor
    residual: Tensor
    converged: Tensor
    evaluations: int


def invert(
    potential: ConvexPotential, y: Tensor, t: Tensor | float = 1.0, c: Tensor | None = None
) -> Inversion:
    """Minimise Phi_t(z) - <y, z> with Phi_t(z) = (1 - t)/2 |z|^2 + t Psi(z; c), row by row.

    This is Newton's method on the gradient. A step is halved until the function still decreases
    along it at its end (so the value is lower, by convexity), or the residual is less than half.
    With t = 1 this inverts the map grad Psi, and z is the gradient of the conjugate Psi^* at y. Up
    to 40 dimensions the steps use full Hessians, above 40 conjugate gradients.

    Args:
        potential: Psi, convex in x.
        y: (B, d).
        t: a number or shape (B,), in [0, 1].
        c: (B, k), or None.

    Raises:
        ValueError: t lies outside [0, 1], or a shape or c does not fit the potential.
        RuntimeError: the potential's gradient or Hessian is not finite.

    Warns:
        InversionWarning: some rows did not converge.
    """
    check_has(potential, "potential", "a ConvexPotential", "given")
    if getattr(y, "dtype", None) in (torch.float16, torch.bfloat16):
        raise TypeError(f"y must have 32 or 64 bits, got {y.dtype}: invert in single precision")
    c = check_inputs(potential, y, c, "y")
    with torch.no_grad():
        return solve(potential.given(c), y.detach(), check_times(t, y))


@torch.no_grad()
def solve(given: Given, y: Tensor, t: Tensor, start: Tensor | None = None) -> Inversion:
    """`invert` with checked arguments, starting at z = `start` (B, d), or at 0 if None."""
    z = torch.zeros_like(y) if start is None else start.clone()
    tolerance = TOLERANCE.get(y.dtype, 1e-4)
    limits = tolerance * (1 + y.norm(dim=1))
    g = _slope(given, z, t) - y
    residual = g.norm(dim=1)
    _check_finite(residual, "gradient")
    p, length = torch.zeros_like(z), torch.ones_like(limits)
    active = (residual > limits).nonzero()[:, 0]  # rows that have not converged
    fresh = active  # active rows that need a new direction
    evaluations = 1
    while len(active) and evaluations < MOST:
        if len(fresh):
            rows, accuracy = given.rows(fresh), residual[fresh].sqrt().clamp(max=0.1)
            p[fresh] = solve_curvature(rows, z[fresh], -g[fresh], t[fresh], accuracy)
        trial = z[active] + length[active, None] * p[active]
        slope = _slope(given.rows(active), trial, t[active]) - y[active]
        evaluations += 1
        size = slope.norm(dim=1)
        downhill = (slope * p[active]).sum(dim=1) <= 0  # along the whole step, by convexity
        better = torch.isfinite(size) & (downhill | (size < residual[active] / 2))
        fresh = active[better]
        z[fresh], g[fresh], residual[fresh] = trial[better], slope[better], size[better]
        length[fresh] = 1.0
        length[active[~better]] /= 2
        going = (residual > limits) & (length > SHORTEST)
        active, fresh = going.nonzero()[:, 0], fresh[going[fresh]]
    converged = residual <= limits
    if not converged.all():
        warnings.warn(
            f"{int((~converged).sum())} of {len(y)} rows did not converge in {evaluations} "
            f"evaluations (largest residual {float(residual.max()):.2g}, tolerance "
            f"{tolerance:.1g} (1 + |y|)): use float64, or check that the map reaches these points",
            InversionWarning,
            stacklevel=4,
        )
    return Inversion(z, residual, converged, evaluations)


@torch.no_grad()
def solve_curvature(
    given: Given, z: Tensor, right: Tensor, t: Tensor, accuracy: Tensor | float = 1e-4
) -> Tensor:
    """Solve (t H(z) + (1 - t) I) p = right for p, where H is the Hessian of the potential.

    Args:
        given: the potential of these rows.
        z: (B, d).
        right: (B, d).
        t: (B,).
        accuracy: relative residual of conjugate gradients, which are used above 40 dimensions.

    Returns:
        p, shape (B, d).
    """
    if z.shape[1] <= EXPLICIT:
        A = t[:, None, None] * given.hessian(z)
        A.diagonal(dim1=1, dim2=2).add_((1 - t)[:, None])
        _check_finite(A.sum(dim=(1, 2)), "Hessian")
        p = torch.linalg.solve_ex(A, right)[0]
    else:
        with torch.enable_grad():
            z = z.detach().requires_grad_(True)
            slope = given.gradient(z)

        def product(v: Tensor) -> Tensor:
            (Hv,) = torch.autograd.grad(slope, z, v, retain_graph=True)
            return t[:, None] * Hv + (1 - t)[:, None] * v

        _check_finite(product(right).sum(dim=1), "Hessian")
        p = _conjugate_gradients(product, right, accuracy)
    # Where the matrix is numerically singular, return the right-hand side: a descent direction.
    return torch.where(torch.isfinite(p).all(dim=1, keepdim=True), p, right)


def _conjugate_gradients(
    product: Callable[[Tensor], Tensor], right: Tensor, accuracy: Tensor | float
) -> Tensor:
    """Solve product(p) = right row by row; a converged row takes steps of length 0."""
    p, r = torch.zeros_like(right), right.clone()
    direction, rr = r.clone(), r.square().sum(dim=1)
    goal = accuracy**2 * rr
    for _ in range(2 * right.shape[1] + 10):
        running = rr > goal
        if not running.any():
            break
        Ad = product(direction)
        length = torch.where(running, rr / (direction * Ad).sum(dim=1), 0.0)
        p = p + length[:, None] * direction
        r = r - length[:, None] * Ad
        new = r.square().sum(dim=1)
        direction = torch.where(running[:, None], r + (new / rr)[:, None] * direction, direction)
        rr = torch.where(running, new, rr)
    return p


def _slope(given: Given, z: Tensor, t: Tensor) -> Tensor:
    """The gradient of Phi_t."""
    t = t[:, None]
    return (1 - t) * z + t * given.gradient(z)


def _check_finite(size: Tensor, what: str) -> None:
    bad = int((~torch.isfinite(size)).sum())
    if bad:
        raise RuntimeError(
            f"the potential's {what} is not finite in {bad} of {len(size)} rows: its parameters "
            "may have diverged (lower learning_rate), or it is not convex"
        )
