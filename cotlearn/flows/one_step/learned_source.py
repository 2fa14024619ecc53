"""A source that depends on the condition and is learned together with the flow."""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import conditional_flow_matching_loss
from cotlearn.flows.networks import seeded

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
