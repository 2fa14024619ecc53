"""Two passes: a regression that refines its own answer once."""

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.matching import Velocity, evaluate, interpolate, squared_error
from cotlearn.validation import check_sampled, check_shape

LATE = 0.9  #: the time of the second pass


class TwoPasses:
    """Minimal iterative policy (2512.01809): |f(0, 0, c) - x1|^2 + |f(t, x_t, c) - x1|^2.

    x_t = (1 - t) x0 + t x1 with t = 0.9 lies near the data. The first term is a regression on the
    condition; the second learns to repair an answer that is nearly right. Sampling is
    deterministic.
    """

    def __call__(self, network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The sum of both squared errors of each row, (B,)."""
        t = pairs.x0.new_full((len(pairs),), LATE)
        second = network(t, interpolate(pairs.x0, pairs.x1, t), pairs.c)
        return regression_loss(network, pairs, generator) + squared_error(second, pairs.x1)

    @torch.no_grad()
    def sample(self, network: Velocity, x0: Tensor, c: Tensor | None = None) -> Tensor:
        """Samples (B, d) by two evaluations; of x0 only the shape is used."""
        c = check_sampled(network, x0, c)
        t = x0.new_full((len(x0),), LATE)
        first = check_shape(predict(network, x0, c), "network", x0.shape, "return").to(x0)
        return evaluate(network, t, LATE * first, c, name="network")
