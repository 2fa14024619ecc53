"""Optimal flow matching: flows that are straight by construction (Kornilov et al. 2403.13117).

The network is a convex potential Psi. Its map x0 -> grad Psi(x0) moves noise to data along straight
lines z_t = (1 - t) z0 + t grad Psi(z0), with the velocity field u_t(z_t) = grad Psi(z0) - z0. Two
losses have the same expected gradient: `optimal_flow_matching_loss` compares velocities at random
times; `dual_loss` is its integral over time in closed form.
"""

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Time, interpolate, uniform_times
from cotlearn.potentials.convex import ConvexPotential, Given
from cotlearn.potentials.inversion import solve, solve_curvature
from cotlearn.validation import check_has, check_inputs, check_same_rows, check_times

LINES = 512  #: most lines that can provide the start of an inversion


def optimal_flow_matching_loss(
    potential: ConvexPotential, pairs: Pairs, generator: torch.Generator | None = None
) -> Tensor:
    """|u_t(x_t) - (x1 - x0)|^2 at one uniform time per row, with a proxy gradient.

    z0 solves (1 - t) z0 + t grad Psi(z0) = x_t and is not differentiated. The value is
    |grad Psi(z0) - z0 - (x1 - x0)|^2 = |z0 - x0|^2/t^2. By the implicit function theorem its
    gradient is that of < stop[2 (t H + (1 - t) I)^{-1} (x0 - z0)/t], grad Psi(z0) >, where H is the
    Hessian of Psi at z0. The expected gradient equals that of twice `dual_objective` for any pairs
    whose noise does not depend on the condition. The smallest expected loss is
    E|x1 - x0|^2 - W2^2, not 0.

    Args:
        potential: Psi.
        pairs: a batch from any coupling.
        generator: draws t on the CPU.

    Returns:
        (B,), the squared error of each row.

    Raises:
        RuntimeError: the potential's gradient or Hessian is not finite.

    Warns:
        InversionWarning: z0 did not converge in some rows; their last iterates are used.
    """
    return optimal_flow_matching_loss_at(potential, pairs, uniform_times(pairs, generator))


def optimal_flow_matching_loss_at(potential: ConvexPotential, pairs: Pairs, t: Time) -> Tensor:
    """`optimal_flow_matching_loss` at given times: a number or shape (B,), in [0, 1]."""
    x0, x1, t = pairs.x0, pairs.x1, check_times(t, pairs.x0)
    x_t, given = interpolate(x0, x1, t), potential.given(pairs.c)
    z0 = solve(given, x_t, t, _near(given, pairs, x_t, t)).z
    slope = given.gradient(z0)
    error = (slope - z0 - (x1 - x0)).detach()  # = (x0 - z0)/t
    weight = 2 * solve_curvature(given, z0, error, t)
    proxy = (weight * slope).sum(dim=1)
    return error.square().sum(dim=1) + proxy - proxy.detach()


def dual_loss(
    potential: ConvexPotential, pairs: Pairs, generator: torch.Generator | None = None
) -> Tensor:
    """2 (Psi(x0) + Psi^*(x1) - <x0, x1>), twice the Fenchel-Young gap of each pair, Hessian-free.

    It is the integral over t of `optimal_flow_matching_loss` for each pair, 0 if x1 = grad Psi(x0)
    and positive otherwise. By the envelope theorem its gradient is that of
    2 (Psi(x0) - Psi(stop[z])) with grad Psi(z) = x1, so the mean gradient of a batch does not
    depend on the pairing.

    Args:
        potential: Psi.
        pairs: a batch from any coupling.
        generator: not used; `fit` passes it to every loss.

    Returns:
        (B,), at least 0 (up to the tolerance of the inversion).
    """
    x0, x1, given = pairs.x0, pairs.x1, potential.given(pairs.c)
    one = torch.ones_like(x1[:, 0])
    z = solve(given, x1, one, _near(given, pairs, x1, one)).z
    conjugate = (x1 * z).sum(dim=1) - given.value(z)
    return 2 * (given.value(x0) + conjugate - (x0 * x1).sum(dim=1))


def dual_objective(
    potential: ConvexPotential, x0: Tensor, x1: Tensor, c: Tensor | None = None
) -> Tensor:
    """L_OT of each row, Psi(x0; c) + Psi^*(x1; c); its mean does not depend on the pairing.

    Args:
        potential: Psi.
        x0: (B, d) noise.
        x1: (B, d) data.
        c: (B, k), or None.

    Returns:
        (B,), differentiable in the parameters.
    """
    check_has(potential, "potential", "a ConvexPotential", "given")
    c = check_inputs(potential, x0, c, "x0")
    check_inputs(potential, x1, c, "x1")
    check_same_rows(x1, "x1", x0, "x0")
    given = potential.given(c)
    z = solve(given, x1, torch.ones_like(x1[:, 0])).z
    return given.value(x0) + (x1 * z).sum(dim=1) - given.value(z)


@torch.no_grad()
def _near(given: Given, pairs: Pairs, y: Tensor, t: Tensor) -> Tensor | None:
    """For each y the start of the nearest line from a row of x0; it halves the inversion's work.

    With conditions every row has its own map, and this would need B^2 evaluations: return None.
    """
    if pairs.c is not None:
        return None
    x0 = pairs.x0[:LINES]
    x1, t = given.gradient(x0), t[:, None]
    # |y - x_t|^2 without |y|^2, which all lines share; x_t = (1 - t) x0 + t x1.
    squared = (1 - t) ** 2 * x0.square().sum(dim=1) + t**2 * x1.square().sum(dim=1)
    squared = squared + 2 * t * (1 - t) * (x0 * x1).sum(dim=1)
    product = (1 - t) * (y @ x0.T) + t * (y @ x1.T)
    nearest = (squared - 2 * product).argmin(dim=1)
    return x0[nearest]


@torch.no_grad()
def transport(potential: ConvexPotential, x0: Tensor, c: Tensor | None = None) -> Tensor:
    """Sample with one evaluation: x1 = grad Psi(x0; c), shape (B, d), from x0 (B, d)."""
    check_has(potential, "potential", "a ConvexPotential", "given")
    return potential.gradient(x0, check_inputs(potential, x0, c, "x0"))


class OptimalField:
    """The velocity field u_t(x; c) = grad Psi(z0) - z0 for `integrate` and `sampler`.

    One Euler step from t = 0 is `transport`; more steps give the same samples but need inversions.

    Args:
        potential: Psi.
    """

    def __init__(self, potential: ConvexPotential) -> None:
        self.potential = check_has(potential, "potential", "a ConvexPotential", "given")
        self.dim, self.condition_dim = potential.dim, potential.condition_dim

    def __call__(self, t: Time, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The velocity (B, d) at x (B, d) and t in [0, 1], a number or of shape (B,)."""
        return straight_line(self.potential, t, x, c)[1]


@torch.no_grad()
def straight_line(
    potential: ConvexPotential, t: Time, x: Tensor, c: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Start z0 and velocity u = grad Psi(z0) - z0 of the line that passes x at time t.

    Args:
        potential: Psi.
        t: a number or shape (B,), in [0, 1].
        x: (B, d).
        c: (B, k), or None.
    """
    time, given = check_times(t, x), potential.given(c)
    z0 = solve(given, x, time).z if time.any() else x
    return z0, given.gradient(z0) - z0
