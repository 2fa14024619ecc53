"""The independent coupling: row i of the noise is paired with row i of the data."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from cotlearn.couplings.base import Coupling, Match, Traits


@dataclass(repr=False)
class Independent(Coupling):
    """Row i with row i, as in conditional flow matching (Lipman 2210.02747, Liu 2209.03003).

    Noise is independent of the condition, so the prior is not skewed; but paths cross, so one-step
    samples are poor.
    """

    name = "independent"
    traits = Traits(solves=False)

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Pair row i with row i."""
        rows = np.arange(len(x0))
        return Match(rows, rows)
