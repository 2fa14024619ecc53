"""Drifting: samples that are trained to move towards the data and away from each other."""

from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Velocity
from cotlearn.validation import check_count

TEMPERATURES = (0.02, 0.05, 0.2)  #: of the softmax, in units of the mean distance of data rows


@dataclass(frozen=True)
class Drifting:
    """The loss of drifting models (2602.04770): |y - (y + V(y))|^2 with a fixed target y + V.

    A network f(x0, c) = network(0, x0, c) makes several samples y for each condition. V pulls a
    sample to data of its condition and pushes it from the other samples; when the samples have the
    law of the data, both cancel. The data of a row are the rows of the batch with an equal
    condition. With a continuous condition there is one: nothing then tells two modes apart but the
    similarity of neighbouring conditions in the network.

    Args:
        draws: samples of each condition, at least 2; the first starts from the noise of the pair.
    """

    draws: int = 8

    def __post_init__(self) -> None:
        check_count(self.draws, "draws", minimum=2)

    def __call__(self, network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """|V|^2 of each row, summed over its samples, (B,)."""
        rows, dim = pairs.x0.shape
        more = torch.randn(rows, self.draws - 1, dim, generator=generator).to(pairs.x0)
        noise = torch.cat([pairs.x0[:, None], more], dim=1).flatten(0, 1)
        c = None if pairs.c is None else pairs.c.repeat_interleave(self.draws, dim=0)
        y = network(noise.new_zeros(()), noise, c).reshape(rows, self.draws, dim)
        same = noise.new_ones(rows, rows, dtype=torch.bool)
        if pairs.c is not None:
            same = (pairs.c[:, None] == pairs.c[None]).all(dim=2)
        with torch.no_grad():
            target = y + sum(drift(y, pairs.x1, same, scale) for scale in TEMPERATURES)
        return (y - target).square().sum(dim=(1, 2))


def drift(y: Tensor, data: Tensor, same: Tensor, temperature: float) -> Tensor:
    """V (B, G, d) of samples y (B, G, d), for data (N, d) that are of their condition.

    Args:
        y: G samples of each of B conditions.
        data: of all conditions.
        same: (B, N), whether a row of the data is of the condition.
        temperature: of the softmax, in units of the mean distance of two rows of the data.
    """
    scale = temperature * torch.cdist(data, data).mean().clamp(min=1e-12)
    to_data = -torch.cdist(y, data.expand(len(y), -1, -1)) / scale
    to_data = to_data.masked_fill(~same[:, None], -torch.inf)
    own = torch.eye(y.shape[1], dtype=torch.bool, device=y.device)
    to_others = (-torch.cdist(y, y) / scale).masked_fill(own, -torch.inf)
    share = torch.cat([to_data, to_others], dim=2).softmax(dim=2)
    pull, push = share.split([len(data), y.shape[1]], dim=2)
    return pull @ data * push.sum(dim=2, keepdim=True) - pull.sum(dim=2, keepdim=True) * (push @ y)
