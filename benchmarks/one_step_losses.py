"""Two ways to few evaluations that no lesson uses: alpha-flow, and a source that is learned."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import (
    conditional_flow_matching_loss,
    interpolate,
    squared_error,
)
from cotlearn.flows.networks import seeded
from cotlearn.flows.one_step import MeanVelocity
from cotlearn.flows.one_step.mean_velocity import LOCATION

STEEPNESS, LEAST_STRAIGHT = 25.0, 0.005  #: of the sigmoid of alpha-flow, and where it ends


@dataclass
class AlphaFlow:
    """The loss of alpha-flow (2510.20771): a straight piece, then a shorter jump.

    From t to r, a share a of the time goes along v = x1 - x0 and the network jumps over the rest.
    The target a v + (1 - a) u(x_s, s, r), with s = t + a (r - t), is fixed. With a = 1 this is flow
    matching at all lengths; as a falls to 0, the gradient of the error divided by a becomes that
    of `MeanFlow`, without a forward-mode product. In `fit`, a falls from 1 to 0.005 by a sigmoid.

    Args:
        steps: in which a falls: those of the training.
        share_instant, power: as in `MeanFlow`; times are logit-normal.
    """

    steps: int
    share_instant: float = 0.75
    power: float = 1.0
    _step: int = field(default=0, init=False, repr=False)

    def observe(self, network: nn.Module, step: int) -> None:
        """Take the step, from which the share a follows."""
        self._step = step

    @property
    def share_straight(self) -> float:
        """The share a of a jump that is straight, at the current step."""
        return max(LEAST_STRAIGHT, 1 / (1 + math.exp(STEEPNESS * (self._step / self.steps - 0.5))))

    def __call__(self, network: MeanVelocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The weighted squared error of each row, (B,)."""
        a = self.share_straight
        t, length = starts_and_lengths(self.share_instant, pairs, generator)
        x, v = interpolate(pairs.x0, pairs.x1, t), pairs.x1 - pairs.x0
        with torch.no_grad():
            later = x + (a * length)[:, None] * v
            rest = network(t + a * length, later, pairs.c, (1 - a) * length)
            straight = torch.where(length > 0, a, 1.0)[:, None]
            target = straight * v + (1 - straight) * rest
        u = network(t, x, pairs.c, length)
        return straight[:, 0] * squared_error(u / straight, target / straight, self.power)


def starts_and_lengths(
    share_instant: float, pairs: Pairs, rng: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Sorted logit-normal times t and r of each row as t and r - t, a share of them with r = t."""
    times = torch.randn(2, len(pairs), generator=rng).to(pairs.x0)
    t, r = (times + LOCATION).sigmoid().sort(dim=0).values
    instant = torch.rand(len(pairs), generator=rng).to(pairs.x0) < share_instant
    return t, (r - t).masked_fill(instant, 0.0)


KL_WEIGHT, ALIGNMENT_WEIGHT = 5.0, 1.0


class LearnedSource(nn.Module):
    """A velocity network, and a source m(c) + s(c) x0 in the place of x0.

    This changes the prior: samples start from `source(x0, c)`. So it does not compare like with
    like where the prior is given.

    Args:
        network: the velocity network; its `dim` and `condition_dim`, at least 1, are read.
        width: neurons of the source's hidden layer.
        seed: of the source's initial weights; torch's global randomness if None.
    """

    def __init__(self, network: nn.Module, *, width: int = 128, seed: int | None = None) -> None:
        super().__init__()
        given: Any = network
        self.network, self.dim, self.condition_dim = given, int(given.dim), int(given.condition_dim)
        if not self.condition_dim:
            raise ValueError("network must have a condition, got condition_dim = 0")
        with seeded(seed):
            first, last = nn.Linear(self.condition_dim, width), nn.Linear(width, 2 * self.dim)
            self.head = nn.Sequential(first, nn.SiLU(), last)

    def forward(self, t: Tensor, x: Tensor, c: Tensor) -> Tensor:
        """The velocity (B, d)."""
        return self.network(t, x, c)

    def mean_and_log_spread(self, c: Tensor) -> tuple[Tensor, Tensor]:
        """m(c) and log s(c), (B, d) each."""
        mean, log_spread = self.head(c).chunk(2, dim=1)
        return mean, log_spread

    def source(self, x0: Tensor, c: Tensor) -> Tensor:
        """The noise (B, d) that standard normal noise x0 (B, d) becomes."""
        mean, log_spread = self.mean_and_log_spread(c)
        return mean + log_spread.exp() * x0


def learned_source_loss(network: LearnedSource, pairs: Pairs, generator: torch.Generator) -> Tensor:
    """Flow matching from the learned source, and two terms that keep the source open, (B,).

    The terms are 5 KL(N(0, s^2) || N(0, 1)), which keeps the spread from collapsing, and
    |m(c) - x1|^2, which draws the mean to the data (in the manner of CSFM, 2602.05951). Flow
    matching alone would shrink the spread: a regression is the straightest flow.
    """
    assert pairs.c is not None
    mean, log_spread = network.mean_and_log_spread(pairs.c)
    moved = replace(pairs, x0=mean + log_spread.exp() * pairs.x0)
    kl = ((2 * log_spread).exp() - 1 - 2 * log_spread).sum(dim=1) / 2
    aligned = (mean - pairs.x1).square().sum(dim=1)
    flow = conditional_flow_matching_loss(network, moved, generator)
    return flow + KL_WEIGHT * kl + ALIGNMENT_WEIGHT * aligned
