"""Classifier-free guidance: one network with and without its condition (Ho & Salimans 2207.12598).

The missing condition is a row of zeros, which no one-hot label is. Of numbers, 0 must not be an
ordinary value: give them a second column of ones.
"""

import warnings
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Velocity, conditional_flow_matching_loss
from cotlearn.validation import check_function, check_number, check_share


@dataclass(frozen=True)
class LabelDropout:
    """`conditional_flow_matching_loss` with the condition hidden in a random share of the rows.

    The condition is hidden after pairing, so a conditional coupling still sees it. Warns
    (UserWarning) if rows of zeros, or one column of both signs, mean something else as well.

    Args:
        share: share of the rows, in [0, 1].
    """

    share: float = 0.2

    def __post_init__(self) -> None:
        check_share(self.share, "share")

    def __call__(
        self, network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
    ) -> Tensor:
        """The squared error of each row, (B,)."""
        if pairs.c is None:
            raise TypeError("LabelDropout needs pairs with a condition c, got None")
        c = pairs.c
        if (c == 0).all(dim=1).any() or (c.shape[1] == 1 and c.min() < 0 < c.max()):
            warnings.warn(
                "c has values at 0 or on both sides of it, and LabelDropout hides a condition by "
                "zeros: give it a further column of ones, so that the two differ",
                stacklevel=2,
            )
        hidden = torch.rand(len(pairs), generator=generator) < self.share
        c = pairs.c.masked_fill(hidden.to(pairs.c.device)[:, None], 0.0)
        return conditional_flow_matching_loss(network, replace(pairs, c=c), generator)


@dataclass(frozen=True)
class Guided:
    """The velocity v(t, x, 0) + scale (v(t, x, c) - v(t, x, 0)).

    Scale 1 is the conditional velocity, scale 0 the unconditional one; a scale above 1 moves
    samples away from the unconditional ones. Each call evaluates the network twice.

    Args:
        velocity: a velocity field trained with `LabelDropout`.
        scale: at least 0.
    """

    velocity: Velocity
    scale: float

    def __post_init__(self) -> None:
        check_function(self.velocity, "velocity", "(t, x, c) -> v")
        check_number(self.scale, "scale")

    @property
    def dim(self) -> int | None:
        """d, the dimension of x, if the velocity has an attribute `dim`; else None."""
        return getattr(self.velocity, "dim", None)

    def __call__(self, t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
        """The guided velocity, (B, d)."""
        if c is None:
            raise TypeError("a guided velocity needs a condition c, got None")
        plain = self.velocity(t, x, torch.zeros_like(c)).clone()  # the next call may overwrite it
        return plain + self.scale * (self.velocity(t, x, c) - plain)
