"""Conditional flow matching: the straight path, its velocity, and the loss."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.validation import check_share


class Velocity(Protocol):
    """A velocity field: (t, x, c) -> (B, d), with t a number or of shape (B,)."""

    def __call__(self, t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
        """The velocity at (t, x) under condition c."""
        ...


class Loss(Protocol):
    """A loss: one value per row of the pairs, shape (B,)."""

    def __call__(
        self, network: torch.nn.Module, pairs: Pairs, generator: torch.Generator
    ) -> Tensor:
        """The loss of each row."""
        ...


def interpolate(x0: Tensor, x1: Tensor, t: Tensor) -> Tensor:
    """The straight path x_t = (1 - t) x0 + t x1 for t of shape (B,).

    Raises:
        TypeError: t is no tensor of real numbers.
        ValueError: x0 and x1 have different shapes, or t has another number of rows.
    """
    if not isinstance(t, Tensor) or not t.is_floating_point():
        raise TypeError(f"t must be a floating-point tensor, got {t!r}")
    if x0.shape != x1.shape or x0.ndim < 2 or t.shape != x0.shape[:1]:
        raise ValueError(
            f"x0 and x1 must have one shape (rows, columns), and t (rows,): got {tuple(x0.shape)}, "
            f"{tuple(x1.shape)} and {tuple(t.shape)}"
        )
    t = t[:, None]
    return (1 - t) * x0 + t * x1


def conditional_flow_matching_loss(
    network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
) -> Tensor:
    """|v(t, x_t, c) - (x1 - x0)|^2 at one uniform time per row (Lipman 2210.02747, eq. 14).

    Args:
        network: called as network(t, x, c).
        pairs: a batch of any coupling.
        generator: draws t on the CPU.

    Returns:
        (B,), the squared error of each row, summed over dimensions.

    Raises:
        ValueError: the network's output has another shape than x1.
    """
    return _loss_at(network, pairs, _times(pairs, generator))


@dataclass(frozen=True)
class EarlyFlowMatching:
    """`conditional_flow_matching_loss` that trains a share of the rows at t = 0.

    The first evaluation is all that one-step sampling has, and a uniform t hardly ever meets it.

    Args:
        share: of the rows, in [0, 1].
    """

    share: float

    def __post_init__(self) -> None:
        check_share(self.share, "share")

    def __call__(
        self, network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
    ) -> Tensor:
        """The squared error of each row, (B,)."""
        early = torch.rand(len(pairs), generator=generator).to(pairs.x0.device) < self.share
        return _loss_at(network, pairs, _times(pairs, generator).masked_fill(early, 0.0))


def _times(pairs: Pairs, generator: torch.Generator | None) -> Tensor:
    times = torch.rand(len(pairs), generator=generator, dtype=pairs.x0.dtype)
    return times.to(pairs.x0.device)


def _loss_at(network: Velocity, pairs: Pairs, t: Tensor) -> Tensor:
    x_t = interpolate(pairs.x0, pairs.x1, t)
    predicted = network(t, x_t, pairs.c)
    if predicted.shape != x_t.shape:  # broadcasting would hide it
        raise ValueError(
            f"network must return shape {tuple(x_t.shape)}, got {tuple(predicted.shape)}"
        )
    return (predicted - (pairs.x1 - pairs.x0)).square().sum(dim=1)


def weighted_mean(losses: Tensor, pairs: Pairs) -> Tensor:
    """The mean of the rows' losses, with the weights that the pairs carry."""
    if losses.shape != (len(pairs),):
        raise ValueError(
            f"loss must return one value per row, shape ({len(pairs)},), got {tuple(losses.shape)}"
        )
    return losses.mean() if pairs.weight is None else (pairs.weight * losses).mean()
