"""Potentials Psi(x; c) that are convex in x: their gradient in x is an optimal transport map.

The networks here are input-convex (Amos et al. 1609.07152): all weights between hidden layers are
positive, and the activation (softplus) is convex and increasing, so the output is convex in x for
any parameters. Weights directly from x may have any sign.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import softplus

from cotlearn.couplings.base import Batches, Pairs
from cotlearn.datasets import Dataset
from cotlearn.flows.networks import seeded
from cotlearn.flows.training import fit
from cotlearn.gaussian import bures_map
from cotlearn.validation import check_count, check_inputs, check_number

SMALLEST_ALPHA = 1e-2  #: with less, nearly flat regions are inverted at t = 1: the loss explodes
AT_THE_START = 0.1  #: size of the network's part relative to the Gaussian part before training
LARGE = 60.0  #: values of x1 from which a start at Gaussians may miss them
START: dict[str, Any] = {"steps": 500, "batch_size": 256, "learning_rate": 1e-2}  #: of a PICNN


class ConvexPotential(nn.Module):
    """Abstract base class of potentials Psi(x; c) that are convex in x.

    A subclass implements `value`, with gradient and Hessian by autodiff; or it implements `given`,
    which returns a function of x with methods `value`, `gradient`, `hessian` and `rows`.

    Args:
        dim: d, columns of x.
        condition_dim: k, columns of c; 0 for no condition (c is then None).
    """

    def __init__(self, dim: int, condition_dim: int = 0) -> None:
        super().__init__()
        self.dim = check_count(dim, "dim")
        self.condition_dim = check_count(condition_dim, "condition_dim", minimum=0)

    def value(self, x: Tensor, c: Tensor | None) -> Tensor:
        """Psi(x; c), shape (B,), convex in x; the formula of a subclass."""
        return self.given(c).value(x)

    def forward(self, x: Tensor, c: Tensor | None = None) -> Tensor:
        """Psi(x; c), shape (B,), for x of shape (B, d) and c of shape (B, k), or None."""
        return self.value(x, c)

    def gradient(self, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The gradient in x, shape (B, d): the transport map, differentiable in the parameters."""
        return self.given(c).gradient(x)

    def hessian(self, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The Hessian in x, shape (B, d, d), symmetric and positive semi-definite."""
        return self.given(c).hessian(x)

    def given(self, c: Tensor | None) -> Given:
        """The potential as a function of x alone, for fixed conditions c (B, k) of its rows."""
        return _ByAutodiff(self, c)


@dataclass(frozen=True)
class _ByAutodiff:
    """Value, gradient and Hessian of any potential by automatic differentiation."""

    potential: ConvexPotential
    c: Tensor | None

    def value(self, x: Tensor) -> Tensor:
        return self.potential.value(x, self.c)

    def gradient(self, x: Tensor) -> Tensor:
        keep = torch.is_grad_enabled()
        with torch.enable_grad():
            x = x if keep and x.requires_grad else x.detach().requires_grad_(True)
            (slope,) = torch.autograd.grad(self.value(x).sum(), x, create_graph=keep)
        return slope

    def hessian(self, x: Tensor) -> Tensor:
        """Computed column by column: the first call of torch's own Hessian takes seconds."""
        keep = torch.is_grad_enabled()
        with torch.enable_grad():
            x = x if keep and x.requires_grad else x.detach().requires_grad_(True)
            (slope,) = torch.autograd.grad(self.value(x).sum(), x, create_graph=True)
            sums = (slope + 0 * x).sum(dim=0)  # 0 * x: a linear potential's slope has no x
            options: Any = {"create_graph": keep, "retain_graph": True}
            columns = [torch.autograd.grad(total, x, **options)[0] for total in sums]
        return torch.stack(columns, dim=2)

    def rows(self, index: Tensor) -> _ByAutodiff:
        """The same potential for some of the rows."""
        return replace(self, c=None if self.c is None else self.c[index])


@dataclass(frozen=True)
class _Layers:
    """An input-convex network with its final weights, shared by all rows or one set per row.

    Psi(x) = <x, Q x>/2 + <b, x> + <w, z_K>, with y = F x (y = x without a frame F),
    a_k = W_k z_k + L_k y + s_k and z_{k+1} = softplus(a_k); z_0 = 0, and W_k and w are positive.
    """

    Q: Tensor  #: (d, d) or (B, d, d)
    b: Tensor  #: (d,) or (B, d)
    L: Tensor  #: (K, width, d)
    W: Tensor  #: (K - 1, width, width)
    s: Tensor  #: (K, width) or (K, B, width)
    w: Tensor  #: (width,) or (B, width)
    F: Tensor | None = None  #: (B, d, d)

    def _forward(self, x: Tensor) -> list[Tensor]:
        """The pre-activations a_k, each (B, width)."""
        y = x if self.F is None else (self.F @ x[:, :, None])[:, :, 0]
        a = [y @ self.L[0].T + self.s[0]]
        for k in range(1, len(self.L)):
            a.append(_softplus(a[-1]) @ self.W[k - 1].T + y @ self.L[k].T + self.s[k])
        return a

    def _backward(self, a: list[Tensor]) -> list[Tensor]:
        """The derivatives of Psi with respect to z_{k+1}, each (B, width) and positive."""
        by_z = [self.w.expand_as(a[-1])]
        for k in range(len(a) - 1, 0, -1):
            by_z.append((by_z[-1] * torch.sigmoid(a[k])) @ self.W[k - 1])
        return by_z[::-1]

    def value(self, x: Tensor) -> Tensor:
        network = (_softplus(self._forward(x)[-1]) * self.w).sum(dim=1)
        return (x * self._times_q(x)).sum(dim=1) / 2 + (x * self.b).sum(dim=1) + network

    def gradient(self, x: Tensor) -> Tensor:
        a = self._forward(x)
        by_y = torch.zeros_like(x)
        for k, by_z in enumerate(self._backward(a)):
            by_y = by_y + (by_z * torch.sigmoid(a[k])) @ self.L[k]
        by_x = by_y if self.F is None else (by_y[:, None, :] @ self.F)[:, 0]
        return self._times_q(x) + self.b + by_x

    def hessian(self, x: Tensor) -> Tensor:
        """Q + sum_k J_k^T diag(dPsi/dz_{k+1} softplus''(a_k)) J_k with J_k = da_k/dx."""
        a = self._forward(x)
        H = self.Q.expand(len(x), *self.Q.shape[-2:])
        J = None
        for k, by_z in enumerate(self._backward(a)):
            direct = self.L[k] if self.F is None else self.L[k] @ self.F
            J = direct if J is None else self.W[k - 1] @ J + direct
            first = torch.sigmoid(a[k])
            second = by_z * first * (1 - first)
            H = H + J.mT @ (second[:, :, None] * J)
            J = first[:, :, None] * J
        return H

    def _times_q(self, x: Tensor) -> Tensor:
        return x @ self.Q if self.Q.ndim == 2 else (self.Q @ x[:, :, None])[:, :, 0]

    def rows(self, index: Tensor) -> _Layers:
        if self.F is None:  # the weights are shared by all rows
            return self
        of_rows = {n: getattr(self, n)[index] for n in ("Q", "b", "w", "F")}
        return replace(self, s=self.s[:, index], **of_rows)


Given: TypeAlias = _ByAutodiff | _Layers


class _InputConvex(ConvexPotential):
    """Base class of `ICNN` and `PICNN`: their shared parameters.

    Args:
        dim: d, columns of x.
        condition_dim: k, columns of c.
        width: neurons of each hidden layer.
        depth: hidden layers.
        alpha: lower bound of the eigenvalues of the Hessian in x, at least 0.01.
    """

    def __init__(
        self,
        dim: int,
        condition_dim: int,
        *,
        width: int = 64,
        depth: int = 3,
        alpha: float = SMALLEST_ALPHA,
    ) -> None:
        super().__init__(dim, condition_dim)
        self.alpha = check_number(alpha, "alpha", minimum=SMALLEST_ALPHA)
        shape = check_count(depth, "depth"), check_count(width, "width")
        self.root = nn.Parameter(torch.eye(dim))
        start = math.log(1 / width)  # softplus(r) is nearly exp(r) here: rows sum to about 1
        self.body = nn.ParameterDict()
        self.body["L"] = torch.randn(*shape, dim) * (2 / math.sqrt(dim))
        self.body["s"] = torch.randn(shape)
        self.body["raw_W"] = torch.randn(depth - 1, width, width) + start - 0.5
        self.body["raw_w"] = torch.full((width,), start + math.log(AT_THE_START))

    def _q(self, root: Tensor) -> Tensor:
        """Q = root root^T + alpha I, positive definite."""
        return root @ root.mT + self.alpha * torch.eye(self.dim).to(root)

    def _layers(self, Q: Tensor, b: Tensor, s: Tensor, w: Tensor, F: Any = None) -> _Layers:
        """The network with its weights W and w made positive."""
        body = self.body
        return _Layers(Q, b, body["L"], softplus(body["raw_W"]), s, softplus(w), F)


class ICNN(_InputConvex):
    """An input-convex network Psi(x) plus a quadratic part.

    Psi(x) = alpha/2 |x|^2 + |R^T x|^2/2 + <b, x> + network(x). Untrained, its gradient is nearly x;
    `start_at_gaussian` makes it nearly the optimal map between Gaussians.

    Args:
        dim: d, columns of x.
        seed: of the initial weights; torch's global randomness if None.
        options: width = 64, the neurons of each hidden layer; depth = 3 hidden layers; and alpha =
            0.01, the lower bound of the Hessian's eigenvalues, not less.
    """

    def __init__(self, dim: int, *, seed: int | None = None, **options: Any) -> None:
        with seeded(seed):
            super().__init__(dim, 0, **options)
        self.b = nn.Parameter(torch.zeros(dim))

    def given(self, c: Tensor | None) -> _Layers:
        """The network with its weights W and w made positive; c is not used."""
        return self._layers(self._q(self.root), self.b, self.body["s"], self.body["raw_w"])

    @torch.no_grad()
    def start_at_gaussian(self, x1: Tensor, c: Tensor | None = None) -> ICNN:
        """Make the gradient nearly the optimal map from N(0, I) to a Gaussian fitted to x1.

        The network's small part is kept, and its gradient at 0 is subtracted from b. It is small
        for data whose deviations are near 1; others should be scaled before.

        Args:
            x1: (n, d) data, n > d.
            c: must be None.

        Returns:
            This potential, changed in place.

        Raises:
            ValueError: x1 has at most d rows, or c is given.
        """
        check_inputs(self, x1, c, "x1")
        if len(x1) <= self.dim:
            raise ValueError(
                f"x1 must have more than {self.dim} rows for a covariance, got {len(x1)}"
            )
        x = x1.detach().to("cpu", torch.float64)
        covariance = np.atleast_2d(np.cov(x.numpy(), rowvar=False))
        floor = 1e-8 * max(covariance.diagonal().mean(), 1e-8)
        eye = np.eye(self.dim)
        slope = torch.from_numpy(bures_map(eye, covariance + floor * eye))
        values, vectors = torch.linalg.eigh(slope)
        self.root.copy_(vectors * (values - self.alpha).clamp_min(0).sqrt())
        self.b.zero_()
        self.b.copy_(x.mean(dim=0).to(self.b) - self.gradient(torch.zeros_like(self.b)[None])[0])
        return self


class PICNN(_InputConvex):
    """A partially input-convex network Psi(x; c): convex in x, any function of c.

    This is `ICNN` with quadratic and linear parts, biases, last weights and frame that are
    functions of c. The frame is a matrix that multiplies x before the hidden layers.

    Args:
        dim: d, columns of x.
        condition_dim: k, columns of c, at least 1.
        condition_width: neurons of each of the two hidden layers that take c.
        seed: of the initial weights; torch's global randomness if None.
        options: width, depth and alpha, as for `ICNN`.
    """

    def __init__(
        self,
        dim: int,
        condition_dim: int,
        *,
        condition_width: int = 64,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        k, n = check_count(condition_dim, "condition_dim"), condition_width
        with seeded(seed):
            super().__init__(dim, k, **options)
            changed = self.body["s"].numel() + self.body["raw_w"].numel()
            self.gaussian = _condition_network(k, n, dim + dim * dim)
            self.shape = _condition_network(k, n, changed + dim * dim)

    def given(self, c: Any) -> _Layers:
        """The network as a function of x alone, for fixed conditions c (B, k)."""
        c = c.to(self.root.dtype)
        Q, b = self._quadratic(c)
        s, w = self.body["s"], self.body["raw_w"]
        shifts, gates, turn = self.shape(c).split([s.numel(), len(w), self.dim**2], dim=1)
        s = s[:, None] + shifts.reshape(len(c), *s.shape).transpose(0, 1)
        F = torch.eye(self.dim).to(c) + turn.reshape(Q.shape)
        return self._layers(Q, b, s, w + gates, F)

    def _quadratic(self, c: Tensor) -> tuple[Tensor, Tensor]:
        """Q(c) of shape (B, d, d), b(c) of shape (B, d)."""
        b, root = self.gaussian(c).split([self.dim, self.dim**2], dim=1)
        root = self.root + root.reshape(len(c), self.dim, self.dim)
        return self._q(root), b

    def start_at_gaussian(self, x1: Tensor, c: Tensor) -> PICNN:
        """Make the gradient nearly the optimal map to N(m(c), S(c)), learned from pairs (x1, c).

        For quadratic potentials the dual of optimal transport needs no inversion: if x0 is standard
        normal and independent of c, E [ <x0, Q x0>/2 + <b, x0> + <x1 - b, Q^{-1} (x1 - b)>/2 ] is
        smallest at b = m(c) and Q = S(c)^{1/2}. `fit` finds this minimum in a few hundred steps,
        for data near unit scale: of values beyond 60 it warns (RuntimeWarning).

        Args:
            x1: (n, d) data.
            c: (n, k) its conditions.

        Returns:
            This potential, changed in place.
        """
        check_inputs(self, x1, c, "x1")
        if (largest := float(x1.detach().abs().max())) > LARGE:
            warnings.warn(
                f"x1 has values up to {largest:.3g}, too far from 0 for these steps: give (x1 - "
                "mean) / deviation, and scale back what the potential makes",
                RuntimeWarning,
                stacklevel=2,
            )
        data, generator = Dataset(x1, c.to(x1.dtype)), torch.Generator().manual_seed(0)
        batches = Batches(_fresh_pairs(data, START["batch_size"], generator))
        trained = fit(self, data, batches, loss=_gaussian_dual, ema=0.0, progress=False, **START)
        self.load_state_dict(trained.network.state_dict())
        return self


def _fresh_pairs(data: Dataset, n: int, generator: torch.Generator) -> Iterator[Pairs]:
    """Yield batches of independent pairs, all drawn from a single generator."""
    while True:
        x1, c = data.sample(n, generator)
        index = torch.arange(n)
        yield Pairs(torch.randn(x1.shape, dtype=x1.dtype, generator=generator), x1, c, index, index)


def _gaussian_dual(network: Any, pairs: Pairs, generator: torch.Generator) -> Tensor:
    Q, b = network._quadratic(pairs.c)
    off = (pairs.x1 - b)[:, :, None]
    conjugate = (off.mT @ torch.linalg.solve(Q, off))[:, 0, 0] / 2
    x0 = pairs.x0
    return ((x0[:, None] @ Q)[:, 0] * x0).sum(dim=1) / 2 + (b * x0).sum(dim=1) + conjugate


def _softplus(a: Tensor) -> Tensor:
    """log(1 + exp(a)); torch's default is linear above 20, where sigmoid is still 1 - 2e-9."""
    return softplus(a, threshold=40)


def _condition_network(inputs: int, width: int, outputs: int) -> nn.Sequential:
    """A small network of the condition, whose output starts near 0."""
    last = nn.Linear(width, outputs)
    with torch.no_grad():
        last.weight.mul_(0.1)
        last.bias.zero_()
    first, second = nn.Linear(inputs, width), nn.Linear(width, width)
    return nn.Sequential(first, nn.SiLU(), second, nn.SiLU(), last)
