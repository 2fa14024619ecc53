"""Conditional Gaussian mixtures in two dimensions, with everything known in closed form.

A mixture here is p(x | c) = sum_k w_k(c) N(x; m_k(c), diag s_k(c)^2). Because it is a mixture of
Gaussians, its density, fresh samples and the velocity field of the *independent* coupling with
standard normal noise are exact: they are the oracles of the course.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, ParamSpec

import torch
from torch import Tensor

from cotlearn import validation

P = ParamSpec("P")
_SHIFT = 0.2  #: torchdyn's noise, before the moons are made 3 x as large


class Components(NamedTuple):
    """The Gaussians of p(x | c), for n conditions, K Gaussians and d dimensions."""

    log_weights: Tensor  #: (n, K), log of weights that sum to one over K
    means: Tensor  #: (n, K, d)
    stds: Tensor  #: (n, K, d), at least 0 (0: this coordinate is certain)


@dataclass(frozen=True)
class ConditionalGaussianMixture:
    """A conditional Gaussian mixture p(x | c) with p(c).

    Attributes:
        name: how the course calls it.
        dim: d, the dimension of x.
        condition_dim: k, the dimension of c.
        components: maps conditions (n, k) to `Components`.
        draw_conditions: `draw_conditions(n, generator)` draws c from p(c), shape (n, k).
        representative: `representative(n)` gives conditions to evaluate on: every condition where
            there are finitely many (n is then ignored), else n of them spread over p(c).
    """

    name: str
    dim: int
    condition_dim: int
    components: Callable[[Tensor], Components]
    draw_conditions: Callable[[int, torch.Generator | None], Tensor]
    representative: Callable[[int], Tensor]

    def __reduce__(self) -> str | tuple[Any, ...]:
        """Pickled for another process as the call that makes it: its functions are closures."""
        call = getattr(self, "_call", None)
        return (_made_again, call) if call else super().__reduce__()

    def sample_conditions(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw n conditions from p(c), shape (n, k)."""
        validation.check_generator(generator)
        return self.draw_conditions(validation.check_count(n, "n"), generator)

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        """Draw n pairs (x1, c) from p(c) p(x | c), of shapes (n, d) and (n, k)."""
        c = self.sample_conditions(n, generator)
        return self.sample_given(c, generator), c

    def sample_given(self, c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw one x from p(x | c) for each row of c, shape (n, d)."""
        validation.check_matrix(c, "c", columns=self.condition_dim)
        validation.check_generator(generator)
        log_weights, means, stds = self.components(c)
        k = torch.multinomial(log_weights.exp(), 1, generator=generator)[:, 0]
        row = torch.arange(len(c))
        noise = torch.randn(len(c), self.dim, generator=generator)
        return means[row, k] + stds[row, k] * noise

    def conditions(self, n: int = 9) -> Tensor:
        """Conditions to evaluate on: all of them if finitely many, else n spread over p(c)."""
        return self.representative(validation.check_count(n, "n"))

    def log_density(self, x: Tensor, c: Tensor) -> Tensor:
        """log p(x | c) for each row, shape (n,).

        Raises:
            ValueError: p(x | c) has no density because a coordinate is certain given c.
        """
        log_weights, means, stds = self.components(validation.check_inputs(self, x, c))
        if (stds == 0).any():
            raise ValueError(f"{self.name}: p(x | c) has no density, c fixes a coordinate of x")
        return torch.logsumexp(log_weights + _log_normal(x, means, stds), dim=1)

    def velocity(self, t: Tensor | float, x: Tensor, c: Tensor) -> Tensor:
        """E[x1 - x0 | x_t = x, c] for x0 ~ N(0, I) independent of x1: the exact field, (n, d).

        Given component k, (x_t, x1 - x0) is jointly Gaussian, so the conditional mean is linear;
        the posterior weights of the components add these up (science of Lipman et al., 2210.02747,
        applied to mixtures). t is a number or has shape (n,), in [0, 1].
        """
        log_weights, means, stds = self.components(validation.check_inputs(self, x, c))
        time = validation.check_times(t, x)[:, None, None]
        variance = (1 - time) ** 2 + time**2 * stds**2  # of x_t given k
        covariance = time * stds**2 - (1 - time)  # of x_t with x1 - x0 given k
        # At t = 1 a certain coordinate has no spread: all that is left there is its mean.
        variance = variance.clamp_min(torch.finfo(x.dtype).tiny ** 0.5)
        likelihood = _log_normal(x, time * means, variance.sqrt())
        posterior = torch.softmax(log_weights + likelihood, dim=1)
        field = means + covariance / variance * (x[:, None, :] - time * means)
        return (posterior[:, :, None] * field).sum(dim=1)


def _log_normal(x: Tensor, means: Tensor, stds: Tensor) -> Tensor:
    """log N(x; means, diag stds^2), shapes (n, d), (n, K, d), (n, K, d) -> (n, K)."""
    z = (x[:, None, :] - means) / stds
    return -(z**2 / 2 + stds.log() + math.log(2 * math.pi) / 2).sum(dim=2)


def _on_circle(angle: Tensor, radius: float) -> Tensor:
    return radius * torch.stack([angle.cos(), angle.sin()], dim=-1)


def _even(means: Tensor, std: float) -> Components:
    """Components of equal weight and equal standard deviation around means (n, K, d)."""
    log_weights = torch.full(means.shape[:2], -math.log(means.shape[1]))
    return Components(log_weights, means, torch.full_like(means, std))


def _one_hot(c: Tensor) -> Tensor:
    """The same labels, checked."""
    if not torch.equal(c, torch.eye(c.shape[1], dtype=c.dtype)[c.argmax(dim=1)]):
        raise ValueError(f"c must be one-hot: one 1 and {c.shape[1] - 1} times 0 in each row")
    return c


def _labelled(name: str, means: Tensor, std: float) -> ConditionalGaussianMixture:
    """One-hot c with equal probabilities; means has shape (conditions, K, d)."""
    n_conditions = len(means)

    def components(c: Tensor) -> Components:
        return _even(means[_one_hot(c).argmax(dim=1)], std)

    def draw(n: int, generator: torch.Generator | None) -> Tensor:
        return torch.eye(n_conditions)[torch.randint(n_conditions, (n,), generator=generator)]

    return ConditionalGaussianMixture(
        name, means.shape[2], n_conditions, components, draw, lambda n: torch.eye(n_conditions)
    )


def _continuous(
    name: str, means: Callable[[Tensor], Tensor], std: float
) -> ConditionalGaussianMixture:
    """c uniform in [-1, 1]; means maps c of shape (n,) to (n, K, d)."""

    def components(c: Tensor) -> Components:
        return _even(means(c[:, 0]), std)

    return ConditionalGaussianMixture(name, 2, 1, components, uniform_conditions, spread_conditions)


def _remembered(
    make: Callable[P, ConditionalGaussianMixture],
) -> Callable[P, ConditionalGaussianMixture]:
    """Its mixtures know the call that made them, to be pickled as that."""

    @functools.wraps(make)
    def made(*args: P.args, **options: P.kwargs) -> ConditionalGaussianMixture:
        mixture = make(*args, **options)
        object.__setattr__(mixture, "_call", (make.__name__, args, options))
        return mixture

    return made


def _made_again(name: str, args: Any, options: Any) -> ConditionalGaussianMixture:
    mixture: ConditionalGaussianMixture = globals()[name](*args, **options)
    return mixture


def uniform_conditions(n: int, generator: torch.Generator | None = None) -> Tensor:
    """n conditions drawn uniformly from [-1, 1], shape (n, 1)."""
    validation.check_generator(generator)
    return 2 * torch.rand(validation.check_count(n, "n"), 1, generator=generator) - 1


def spread_conditions(n: int) -> Tensor:
    """n conditions evenly spread over [-1, 1], shape (n, 1)."""
    return ((torch.arange(validation.check_count(n, "n")) + 0.5) / n * 2 - 1)[:, None]


@_remembered
def petals(n_conditions: int = 4) -> ConditionalGaussianMixture:
    """Petals on a ring: the course's first example.

    Condition k (one-hot) sits at angle 2 pi k / n on a ring of radius 4; p(x | c) has two equal
    modes at -1.2 and +1.2 along the tangent, standard deviation 0.25.
    """
    k = torch.arange(validation.check_count(n_conditions, "n_conditions"))
    angle = 2 * math.pi * k / n_conditions
    tangent = _on_circle(angle + math.pi / 2, 1.2)
    centre = _on_circle(angle, 4.0)
    return _labelled("petals", torch.stack([centre - tangent, centre + tangent], dim=1), 0.25)


@_remembered
def moving_modes() -> ConditionalGaussianMixture:
    """c in [-1, 1] turns two opposite modes at radius 2 about the origin, by pi c / 2.

    The mean of p(x | c) is zero for every c: whoever looks only at means sees no condition here.
    """

    def means(c: Tensor) -> Tensor:
        mode = _on_circle(math.pi / 2 * c, 2.0)
        return torch.stack([-mode, mode], dim=1)

    return _continuous("moving_modes", means, 0.25)


@_remembered
def rotating_pair() -> ConditionalGaussianMixture:
    """c in [-1, 1] moves a pair of modes along half a circle of radius 3: the mean moves.

    The modes lie 1 inside and 1 outside the arc; standard deviation 0.25.
    """

    def means(c: Tensor) -> Tensor:
        angle = math.pi / 2 * c
        return torch.stack([_on_circle(angle, 2.0), _on_circle(angle, 4.0)], dim=1)

    return _continuous("rotating_pair", means, 0.25)


@_remembered
def fork() -> ConditionalGaussianMixture:
    """c in [-1, 1] walks along a road that forks at c = 0 (after COT Policy, 2505.01179).

    x = (3 c, +-2.5 max(c, 0)) with standard deviation 0.15: one mode before the fork, two after.
    """

    def means(c: Tensor) -> Tensor:
        branch = torch.stack([3 * c, 2.5 * c.clamp_min(0)], dim=1)
        return torch.stack([branch, branch * torch.tensor([1.0, -1.0])], dim=1)

    return _continuous("fork", means, 0.15)


@_remembered
def eight_gaussians() -> ConditionalGaussianMixture:
    """Eight Gaussians on a circle of radius 5, standard deviation sqrt(0.1); c = which (one-hot).

    Use `unconditional(eight_gaussians())` for the mixture of all eight without a condition.
    """
    means = _on_circle(2 * math.pi * torch.arange(8) / 8, 5.0)
    return _labelled("eight_gaussians", means[:, None, :], math.sqrt(0.1))


@_remembered
def moons(condition: str = "class", *, torchdyn: bool = False) -> ConditionalGaussianMixture:
    """Two moons of 3 x the usual size, with the moon (one-hot) or the x coordinate as condition.

    Each moon is a mixture of 64 Gaussians of standard deviation 0.6 along a half circle, closer
    to each other (0.15) than they are wide, so that even moons have a density in closed form.

    Args:
        condition: "class", c is one-hot of shape (n, 2); or "x", c is the first coordinate of x,
            which is then certain given c (Cheng & Schwing 2503.10636, Figure 1).
        torchdyn: the moons of that figure, from torchdyn's `generate_moons`. The only noise is one
            number, uniform in [0, 0.6], that is added to *both* coordinates of a point of the half
            circle. `sample` spreads the angles evenly and draws each moon equally often, so that
            two samples differ less than independent draws do; `sample_given` draws independently
            ("x": c from -4 to 5.6). These moons are no mixture of Gaussians: `log_density` and
            `velocity` raise a ValueError.
    """
    std, points = 0.6, 64
    validation.check_choice(condition, "condition", ("class", "x"))
    if torchdyn:
        return _moons_of_torchdyn(condition)
    angle = math.pi * (torch.arange(points) + 0.5) / points
    means = 3 * torch.stack([_half_circle(moon, angle) for moon in (0, 1)]) - 1
    if condition == "class":
        return _labelled("moons", means, std)
    return _moons_given_x(means.reshape(-1, 2), std)


def _half_circle(moon: Tensor | int, angle: Tensor) -> Tensor:
    """Points (n, 2) at these angles, on the upper half circle (moon 0) or the lower one (1)."""
    upper = _on_circle(angle, 1.0)
    lower = torch.tensor([1.0, 0.5]) - upper
    return torch.where(torch.as_tensor(moon)[..., None] == 0, upper, lower)


def _moons_given_x(means: Tensor, std: float) -> ConditionalGaussianMixture:
    def components(c: Tensor) -> Components:
        log_weights = torch.log_softmax(-((c - means[:, 0]) ** 2) / (2 * std**2), dim=1)
        heights = means[:, 1].expand(len(c), -1)
        points = torch.stack([c.expand_as(heights), heights], dim=2)
        return Components(log_weights, points, torch.tensor([0.0, std]).expand_as(points))

    def draw(n: int, generator: torch.Generator | None) -> Tensor:
        k = torch.randint(len(means), (n,), generator=generator)
        return means[k, :1] + std * torch.randn(n, 1, generator=generator)

    def spread(n: int) -> Tensor:
        centres, _ = means[:, 0].sort()
        return centres[((torch.arange(n) + 0.5) / n * len(centres)).long(), None]

    return ConditionalGaussianMixture("moons", 2, 1, components, draw, spread)


class _TorchdynMoons(ConditionalGaussianMixture):
    """Moons of which only samples are known: half circles, shifted along the diagonal."""

    def sample(self, n: int, generator: torch.Generator | None = None) -> tuple[Tensor, Tensor]:
        order = torch.randperm(validation.check_count(n, "n"), generator=generator)
        sizes = (n // 2, n - n // 2)
        angle = torch.cat([torch.linspace(0, math.pi, size) for size in sizes])[order]
        moon = (order >= n // 2).long()
        shift = _SHIFT * torch.rand(n, 1, generator=generator)
        x = 3 * (_half_circle(moon, angle) + shift) - 1
        return x, torch.eye(2)[moon] if self.condition_dim == 2 else x[:, :1].clone()

    def sample_given(self, c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw independently, by the angles: they are uniform where c allows them."""
        validation.check_matrix(c, "c", columns=self.condition_dim)
        by_moon = self.condition_dim == 2
        if by_moon:  # from 0 to pi on this moon
            first, last = torch.zeros_like(c), math.pi * _one_hot(c)
        else:  # from where a shift leads to c: one interval on each moon
            place = (c + 1) / 3
            cosine = torch.cat([place, 1 + _SHIFT - place], dim=1)
            first, last = (x.clamp(-1, 1).acos() for x in (cosine, cosine - _SHIFT))
        if (last <= first).all(dim=1).any():
            raise ValueError("c must lie between -4 and 5.6, where the moons are")
        moon = torch.multinomial(last - first, 1, generator=generator)
        low, high = first.gather(1, moon)[:, 0], last.gather(1, moon)[:, 0]
        angle = low + (high - low) * torch.rand(len(c), generator=generator)
        point = _half_circle(moon[:, 0], angle)
        if by_moon:
            return 3 * (point + _SHIFT * torch.rand(len(c), 1, generator=generator)) - 1
        return torch.cat([c, 3 * (point[:, 1:] + place - point[:, :1]) - 1], dim=1)


def _moons_of_torchdyn(condition: str) -> ConditionalGaussianMixture:
    usual = moons(condition)
    k = usual.condition_dim

    def refuse(c: Tensor) -> Components:
        raise ValueError("torchdyn's moons: only samples are known, no density and no velocity")

    def draw(n: int, generator: torch.Generator | None) -> Tensor:
        return data.sample(n, generator)[1]

    def spread(n: int) -> Tensor:
        return usual.representative(n) + (3 * _SHIFT / 2 if k == 1 else 0)

    data = _TorchdynMoons("torchdyn's moons", 2, k, refuse, draw, spread)
    return data
