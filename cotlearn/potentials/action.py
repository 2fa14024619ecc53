"""Action Matching (Neklyudov et al. 2210.06662): learn s(t, x; c) whose gradient is the velocity.

The loss is L_AM(s) = E s_0(x0) - E s_1(x1) + int E[ |grad s_t|^2/2 + ds_t/dt ](x_t) dt, where x_t
follows any path of laws from noise to data. `ActionMLP` is unrestricted: its gradient learns the
curl-free field that generates the path. `OptimalAction` is given by a convex potential: its
integrand is 0 everywhere, so the path does not matter, and the loss is the dual of optimal
transport (2510.27385).
"""

from collections.abc import Callable
from typing import Any, TypeAlias

import torch
from torch import Tensor, nn

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Time, interpolate, uniform_times
from cotlearn.flows.networks import VelocityMLP
from cotlearn.potentials.convex import ConvexPotential
from cotlearn.potentials.optimal_flow import OptimalField, straight_line
from cotlearn.validation import check_shape, check_times

#: Interpolates: x_t of shape (B, d) from x0 and x1 of shape (B, d) and t of shape (B,).
Path: TypeAlias = Callable[[Tensor, Tensor, Tensor], Tensor]


class ActionMLP(nn.Module):
    """An unrestricted action s(t, x, c) = <f(t, x, c), x> with a multilayer perceptron f.

    s_t(0; c) = 0 is no restriction: adding a function of t and c to s changes neither its gradient
    in x nor the loss.

    Args:
        dim: d, columns of x.
        condition_dim: k, columns of c; 0 for no condition.
        options: width, depth and seed of f, as for `VelocityMLP`.
    """

    def __init__(self, dim: int, condition_dim: int = 0, **options: Any) -> None:
        super().__init__()
        self.network = VelocityMLP(dim, condition_dim, **options)
        self.dim, self.condition_dim = dim, condition_dim

    def forward(self, t: Time, x: Tensor, c: Tensor | None = None) -> Tensor:
        """s_t(x; c), shape (B,), for t a number or of shape (B,), in [0, 1]."""
        return (self.network(t, x, c) * x).sum(dim=1)

    def derivatives(self, t: Time, x: Tensor, c: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """ds/dt of shape (B,) and grad s of shape (B, d), differentiable in the weights."""
        keep = torch.is_grad_enabled()
        with torch.enable_grad():
            time = check_times(t, x).clone().requires_grad_(True)
            x = x.detach().requires_grad_(True)
            s = self(time, x, c).sum()
            by_t, by_x = torch.autograd.grad(s, (time, x), create_graph=keep)
        return by_t, by_x

    def velocity(self, t: Time, x: Tensor, c: Tensor | None = None) -> Tensor:
        """grad s_t(x; c), shape (B, d), the velocity field for `integrate`."""
        return self.derivatives(t, x, c)[1]


class OptimalAction(nn.Module):
    """The action of a potential's straight flow, s_t(x) = |x|^2/(2t) - Phi_t^*(x)/t (identity I3).

    Let z0 be the start of the line that passes x at time t, and u = grad Psi(z0) - z0 its velocity.
    Then s_t(x) = t |u|^2/2 + Psi(z0) - |z0|^2/2, which is defined at t = 0, too. It solves the
    Hamilton-Jacobi equation ds/dt + |grad s|^2/2 = 0, and grad s = u.

    Args:
        potential: Psi; the action has no other parameters.

    Attributes:
        velocity: u_t(x; c) = grad s_t(x; c), an `OptimalField`.
    """

    def __init__(self, potential: ConvexPotential) -> None:
        super().__init__()
        self.potential, self.velocity = potential, OptimalField(potential)
        self.dim, self.condition_dim = potential.dim, potential.condition_dim

    def forward(self, t: Time, x: Tensor, c: Tensor | None = None) -> Tensor:
        """s_t(x; c), shape (B,); its gradient in the parameters is exact (envelope theorem)."""
        time = check_times(t, x)
        z0, u = straight_line(self.potential, time, x, c)
        start = self.potential(z0, c) - z0.square().sum(dim=1) / 2
        return time / 2 * u.square().sum(dim=1) + start

    def derivatives(self, t: Time, x: Tensor, c: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """ds/dt = -|u|^2/2 of shape (B,) and grad s = u of shape (B, d), without a graph."""
        u = self.velocity(t, x, c)
        return -u.square().sum(dim=1) / 2, u


def action_matching_loss(
    action: ActionMLP | OptimalAction,
    pairs: Pairs,
    generator: torch.Generator | None = None,
    *,
    path: Path = interpolate,
) -> Tensor:
    """s_0(x0) - s_1(x1) + |grad s_t(x_t)|^2/2 + ds_t/dt(x_t), at one time per row.

    For a field v that generates the law of x_t, the expected loss is E|grad s - v|^2/2 up to a
    constant; on straight paths L_FM(grad s) = 2 L_AM(s) + E|x1 - x0|^2 (identity I2). The loss can
    be negative.

    Args:
        action: an `ActionMLP` or `OptimalAction`.
        pairs: a batch from any coupling.
        generator: draws t on the CPU.
        path: path(x0, x1, t) -> x_t, equal to x0 at t = 0 and to x1 at t = 1; straight lines by
            default. To use another path in `fit`, bind it with `functools.partial`.

    Returns:
        (B,), the loss of each row.

    Raises:
        ValueError: path returns another shape than that of x0.
    """
    x0, x1, c = pairs.x0, pairs.x1, pairs.c
    t = _stratified_times(pairs, generator)
    x_t = check_shape(path(x0, x1, t), "path", x0.shape, "return")
    by_t, by_x = action.derivatives(t, x_t, c)
    return action(0.0, x0, c) - action(1.0, x1, c) + by_x.square().sum(dim=1) / 2 + by_t


def _stratified_times(pairs: Pairs, generator: torch.Generator | None) -> Tensor:
    """Draw one time in each of B equal parts of [0, 1], which lowers the loss's variance."""
    t = uniform_times(pairs, generator)
    place = torch.randperm(len(t), generator=generator).to(t.device)
    return ((place + t) / len(t)).clamp(max=1)
