"""Reflow: pairs made by a flow that is trained already, the honest distillation baseline."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Match, Pairs, StreamOptions, generator_for
from cotlearn.validation import check_same_rows


class Reflow(Coupling):
    """Noise meets what a teacher makes of it (rectified flow, Liu 2209.03003).

    x1 of the pairs is teacher(x0, c) and no longer data: the student learns the teacher's map, with
    its errors, along straight paths. The conditions come from the data.

    Args:
        teacher: (x0, c) -> x1 of the shape of x0, for instance
            `lambda x0, c: integrate(network, x0, c, nfe=16).x1`.
    """

    name = "reflow"

    def __init__(self, teacher: Callable[[Tensor, Tensor | None], Tensor]) -> None:
        if not callable(teacher):
            raise TypeError(f"teacher must be a function (x0, c) -> x1, got {teacher!r}")
        self._teacher = teacher

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Row i of the noise meets the teacher's sample from it."""
        made = self._teacher(x0, c)
        if not isinstance(made, Tensor) or made.shape != x0.shape or not torch.isfinite(made).all():
            got = tuple(made.shape) if isinstance(made, Tensor) else type(made).__name__
            raise ValueError(f"teacher must return finite values of shape {tuple(x0.shape)}: {got}")
        rows = np.arange(len(x0))
        return Match(rows, rows, x1=made)


class MadePairs(Coupling):
    """Reflow with pairs that were made once: row i of the noise belongs to row i of the data.

    Cheaper than `Reflow` where a student trains for long, because the teacher is asked only once.

    Args:
        x0: (N, d), the noise of the N rows of the data.
    """

    name = "reflow"
    solves = False
    whole_data = True

    def __init__(self, x0: Tensor) -> None:
        self._x0 = x0

    def batches(self, data: Any, options: StreamOptions) -> Iterator[Pairs]:
        """Batches of rows drawn with replacement."""
        check_same_rows(self._x0, "x0", data.x1, "x1 of the data")
        for number in itertools.count(options.start):
            rng = generator_for(options.seed, number)
            rows = torch.randint(len(data), (options.batch_size,), generator=rng)
            yield Pairs(self._x0[rows], data.x1[rows], data.c[rows], rows, rows)
