"""The independent coupling: row i of the noise meets row i of the data."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from cotlearn.couplings.base import Coupling, Match


@dataclass(repr=False)
class Independent(Coupling):
    """Conditional flow matching's coupling: no cost, i = j (Lipman 2210.02747, Liu 2209.03003).

    Noise never depends on the condition, so there is no skew; but paths cross, so one step is bad.
    """

    name = "independent"
    solves = False

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Row i meets row i."""
        rows = np.arange(len(x0))
        return Match(rows, rows)
