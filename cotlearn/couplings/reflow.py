"""Reflow: pairs made by a flow that is trained already, the honest distillation baseline."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Match, Pairs, Source, check_like
from cotlearn.couplings.independent import Independent
from cotlearn.renamed import renamed
from cotlearn.validation import check_same_rows


@dataclass(repr=False)
class Reflow(Coupling):
    """Noise meets what a teacher makes of it (rectified flow, Liu 2209.03003).

    x1 of the pairs is teacher(x0, c) and no longer data: the student learns the teacher's map, with
    its errors, along straight paths. The conditions come from the data.

    Args:
        teacher: (x0, c) -> x1 of the shape of x0, for instance
            `lambda x0, c: integrate(network, x0, c, nfe=16).x1`.
    """

    teacher: Callable[[Tensor, Tensor | None], Tensor] = field(repr=False)

    name = "reflow"
    transformable = False

    def __post_init__(self) -> None:
        if not callable(self.teacher):
            raise TypeError(f"teacher must be a function (x0, c) -> x1, got {self.teacher!r}")

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Row i of the noise meets the teacher's sample from it."""
        made = check_like(self.teacher(x0, c), "teacher(x0, c)", x0)
        rows = np.arange(len(x0))
        return Match(rows, rows, x1=made)


@dataclass(repr=False, eq=False)
class FixedPairs(Independent):
    """Reflow with pairs that were made once: row i of the noise belongs to row i of the data.

    Cheaper than `Reflow` where a student trains for long, because the teacher is asked only once.
    A stream draws rows with replacement; their indices are rows of the data.

    Args:
        x0: (N, d), the noise of the N rows of the data.
    """

    x0: Tensor = field(repr=False)

    name = "reflow"
    whole_data = True
    transformable = False

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Raise ValueError unless noise and data have the same number of rows."""
        check_same_rows(self.x0, "x0", data.x1, "x1 of the data")

    def solve(self, data: Any, n: int, source: Source | None, generator: torch.Generator) -> Pairs:
        """Some of the pairs."""
        drawn = torch.randint(len(data), (n,), generator=generator)
        return Pairs(self.x0[drawn], data.x1[drawn], data.c[drawn], drawn, drawn)


__getattr__ = renamed(__name__, {"MadePairs": "FixedPairs"})
