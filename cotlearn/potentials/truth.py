"""Problems with a known optimal map from standard normal noise, the ground truth of L2-UVP."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.distances import squared_distances
from cotlearn.mixtures import spread_conditions, uniform_conditions
from cotlearn.potentials.convex import ConvexPotential

RADIUS, WIDE, NARROW = 3.0, 1.0, 0.3  #: of `ConditionalGaussian`
PIECES, SPREAD = 8, 2.0  #: of `LogSumExp`


class LogSumExp(ConvexPotential):
    """Psi(x) = alpha/2 |x|^2 + temperature log sum_i exp((<a_i, x> + b_i)/temperature), random.

    Its gradient is a known optimal transport map, a ground truth in any dimension. There are eight
    random pieces, a_i ~ N(0, 8/d I) and b_i ~ N(0, 4). From one piece to the next the map moves by
    about 4 in any dimension, the more abruptly the lower `temperature` is.

    Args:
        dim: d, columns of x.
        seed: of the pieces.
    """

    a: Tensor
    b: Tensor
    alpha, temperature = 0.5, 1.0

    def __init__(self, dim: int, *, seed: int = 0) -> None:
        super().__init__(dim)
        generator = torch.Generator().manual_seed(validation.check_seed(seed))
        a = torch.randn(PIECES, dim, generator=generator) * math.sqrt(2 / dim)
        self.register_buffer("a", SPREAD * a)
        self.register_buffer("b", SPREAD * torch.randn(PIECES, generator=generator))

    def value(self, x: Tensor, c: Tensor | None) -> Tensor:
        """Psi(x), shape (B,)."""
        T = self.temperature
        pieces = torch.logsumexp((x @ self.a.T + self.b) / T, dim=1)
        return self.alpha / 2 * x.square().sum(dim=1) + T * pieces


@dataclass
class KnownMap:
    """Data x1 = T(x0), x0 ~ N(0, I), where T is the gradient of a convex function.

    Args:
        true_map: T, from (n, d) to (n, d); for instance `LogSumExp(2).gradient`.
        dim: d.
        name: label in figures and checkpoints.
    """

    true_map: Callable[[Tensor], Tensor]
    dim: int
    name: str = "known_map"
    condition_dim = 0

    def __post_init__(self) -> None:
        validation.check_function(self.true_map, "true_map", "of x0")
        validation.check_count(self.dim, "dim")

    @classmethod
    def gaussian(cls, dim: int, *, seed: int = 0) -> KnownMap:
        """A random Gaussian: standard deviations 0.3 to 2 along random axes, mean from N(0, I)."""
        generator = torch.Generator().manual_seed(validation.check_seed(seed))
        validation.check_count(dim, "dim")
        axes = torch.linalg.qr(torch.randn(dim, dim, generator=generator))[0]
        slope = axes * torch.linspace(0.3, 2.0, dim) @ axes.T
        mean = torch.randn(dim, generator=generator)
        return cls(lambda x: x @ slope.to(x) + mean.to(x), dim, name="gaussian")

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, None]:
        """Draw n rows of x1; there is no condition."""
        validation.check_generator(generator)
        x0 = torch.randn(validation.check_count(n, "n"), self.dim, generator=generator)
        return self.transport(x0), None

    @torch.no_grad()
    def transport(self, x0: Tensor, c: Tensor | None = None) -> Tensor:
        """T(x0), shape (n, d); c must be None."""
        validation.check_inputs(self, x0, c, "x0")
        return self.true_map(x0)


class ConditionalGaussian:
    """x1 | c ~ N(m(c), S(c)) for c uniform in [-1, 1]: T_c(x) = m(c) + S(c)^{1/2} x.

    In each pair of coordinates x1 is an elliptic Gaussian (standard deviation 1 along the radius,
    0.3 along the circle) that moves with c along half a circle of radius 3; the pairs start at
    different angles. In an odd dimension the last coordinate is N(3 c, 0.3^2).

    Args:
        dim: d.
    """

    condition_dim = 1
    name = "conditional_gaussian"

    def __init__(self, dim: int = 2) -> None:
        self.dim = validation.check_count(dim, "dim")

    def moments(self, c: Tensor) -> tuple[Tensor, Tensor]:
        """m(c) of shape (n, d) and S(c)^{1/2} of shape (n, d, d)."""
        pairs = self.dim // 2
        angle = math.pi / 2 * c + math.pi * torch.arange(pairs) / max(pairs, 1)  # (n, pairs)
        outward = torch.stack([angle.cos(), angle.sin()], dim=2)
        mean = (RADIUS * outward).reshape(len(c), 2 * pairs)
        root = torch.zeros(len(c), self.dim, self.dim, dtype=c.dtype)
        blocks = NARROW * torch.eye(2) + (WIDE - NARROW) * outward[..., None] * outward[:, :, None]
        for j in range(pairs):
            root[:, 2 * j : 2 * j + 2, 2 * j : 2 * j + 2] = blocks[:, j]
        if self.dim % 2:
            mean = torch.cat([mean, RADIUS * c], dim=1)
            root[:, -1, -1] = NARROW
        return mean.to(c.dtype), root

    def transport(self, x0: Tensor, c: Tensor) -> Tensor:
        """T_c(x0), shape (n, d)."""
        mean, root = self.moments(validation.check_inputs(self, x0, c, "x0"))
        return mean.to(x0) + (root.to(x0) @ x0[:, :, None])[:, :, 0]

    def variance(self) -> float:
        """The trace of S(c), which is the same for every c."""
        return self.dim // 2 * (WIDE**2 + NARROW**2) + self.dim % 2 * NARROW**2

    def sample_conditions(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw n conditions, shape (n, 1)."""
        return uniform_conditions(n, generator)

    def sample_given(self, c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw one x1 for each row of c, shape (n, d)."""
        validation.check_generator(generator)
        c = validation.check_condition(c, columns=1)
        return self.transport(torch.randn(len(c), self.dim, generator=generator), c)

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        """Draw n pairs (x1, c) of shapes (n, d) and (n, 1)."""
        c = self.sample_conditions(n, generator)
        return self.sample_given(c, generator), c

    def conditions(self, n: int = 9) -> Tensor:
        """n conditions spread over [-1, 1], shape (n, 1)."""
        return spread_conditions(n)


def eight_gaussians_map(n: int = 1024, *, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Points x0 and T(x0) of the optimal map from N(0, I) to `mixtures.eight_gaussians`.

    Both laws have the 16 symmetries of the octagon, so T maps a wedge of 22.5 degrees to itself.
    Inside the wedge T maps a slice of the normal law to half of one Gaussian, and an assignment of
    n low-discrepancy points to n others approximates it; reflections and rotations give the other
    wedges. (The other Gaussians are six standard deviations away from the wedge.)

    Args:
        n: points in the wedge, a power of 2.
        seed: of the points.

    Returns:
        x0 and T(x0), both (16 n, 2). The squared error of T, due to the finite grid, is about
        0.001 % of the variance at n = 1024.

    Raises:
        ValueError: n is not a power of 2.
    """
    seed = validation.check_seed(seed)
    if validation.check_count(n, "n") & (n - 1):
        raise ValueError(f"n must be a power of 2, got {n}")
    engines = (torch.quasirandom.SobolEngine(2, scramble=True, seed=seed + k) for k in (0, 1))
    u, v = (engine.draw(n).double().clamp(1e-9, 1 - 1e-9) for engine in engines)
    radius, angle = (-2 * u[:, 0].log()).sqrt(), math.pi / 8 * u[:, 1]
    x0 = torch.stack([radius * angle.cos(), radius * angle.sin()], dim=1)
    normal = math.sqrt(2 * 0.1) * torch.erfinv(2 * v - 1)  # standard deviation sqrt(0.1)
    x1 = torch.stack([5 + normal[:, 0], normal[:, 1].abs()], dim=1)
    cost = squared_distances(x0 - x0.mean(dim=0), x1 - x1.mean(dim=0))  # shifts change nothing
    x1 = x1[torch.from_numpy(linear_sum_assignment(cost)[1])]
    both = torch.cat([x0, x1])
    both = torch.cat([both[None], (both * torch.tensor([1.0, -1.0]))[None]])  # reflection
    turns = math.pi / 4 * torch.arange(8, dtype=torch.float64)
    turn = torch.stack([turns.cos(), turns.sin(), -turns.sin(), turns.cos()], 1).reshape(8, 2, 2)
    images = (both[:, None] @ turn).float()  # (2, 8, 2n, 2)
    return images[:, :, :n].reshape(-1, 2), images[:, :, n:].reshape(-1, 2)
