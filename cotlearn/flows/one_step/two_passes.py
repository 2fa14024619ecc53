"""Two passes: a regression that refines its own answer once."""

from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.matching import Velocity, interpolate, squared_error
from cotlearn.validation import check_share


@dataclass(frozen=True)
class TwoPasses:
    """Minimal iterative policy (2512.01809): |f(0, 0, c) - x1|^2 + |f(s, x_s, c) - x1|^2.

    x_s = (1 - s) x0 + s x1 lies near the data. The first term is a regression on the condition; the
    second learns to repair an answer that is nearly right. Sampling is deterministic.

    Args:
        late: s, in [0, 1].
    """

    late: float = 0.9

    def __post_init__(self) -> None:
        check_share(self.late, "late")

    def __call__(self, network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The sum of both squared errors of each row, (B,)."""
        s = pairs.x0.new_full((len(pairs),), self.late)
        second = network(s, interpolate(pairs.x0, pairs.x1, s), pairs.c)
        return regression_loss(network, pairs, generator) + squared_error(second, pairs.x1)

    @torch.no_grad()
    def sample(self, network: Velocity, x0: Tensor, c: Tensor | None = None) -> Tensor:
        """Samples (B, d) by two evaluations; of x0 only the shape is used."""
        s = x0.new_full((len(x0),), self.late)
        return network(s, self.late * predict(network, x0, c), c)
