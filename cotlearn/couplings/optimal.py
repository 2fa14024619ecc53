"""Minibatch optimal transport: noise is paired with near data, whatever the condition."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from cotlearn.couplings.assignment import (
    draw_pairs,
    exact_permutation,
    sinkhorn_plan,
)
from cotlearn.couplings.base import Array, Coupling, Match, Traits
from cotlearn.couplings.distances import pairing_cost, squared_distances, to_numpy
from cotlearn.validation import check_choice, check_positive


@dataclass(repr=False, kw_only=True)
class MinibatchOT(Coupling):
    """OT-CFM: the plan of a batch for the cost |x0 - x1|^2 (Tong 2302.00482, Pooladian 2304.14772).

    It ignores c. That is right for data without a condition; with a condition it is the *naive*
    coupling, because p(x0 | c) in training is no longer the prior.

    Args:
        plan: "exact" (an assignment) or "sinkhorn" (entropic).
        sampling: "permutation" uses every row exactly once; for Sinkhorn it is the permutation
            with the largest sum of plan entries. "replacement" draws B pairs from the plan, as
            torchcfm does, and misses about a share 1/e of the data in each batch.
        regularization: of Sinkhorn, above 0, in units of the batch's mean cost.

    Raises:
        ValueError: plan or sampling is unknown, or regularization is not above 0.
    """

    plan: str = "exact"
    sampling: str = "permutation"
    regularization: float = 0.05

    name = "minibatch_ot"
    traits = Traits(uses_ot_batch=True)

    def __post_init__(self) -> None:
        self._check_options()
        self.regularization = check_positive(self.regularization, "regularization")

    def _check_options(self) -> None:
        """They may have been set since."""
        check_choice(self.plan, "plan", ("exact", "sinkhorn"))
        check_choice(self.sampling, "sampling", ("permutation", "replacement"))

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Pair the batch by its plan."""
        self._check_options()
        if self.plan == "sinkhorn" and self.sampling == "replacement":
            return Match(*draw_pairs(self._entropic(x0, x1), len(x0), rng))
        rows = np.arange(len(x0))
        if self.sampling == "replacement":  # the plan is uniform over the pairs (i, columns[i])
            rows = rng.integers(len(rows), size=len(rows))
        # Solvers deal equal columns, and those that differ by rounding, by their places: of a batch
        # that is sorted by the condition, noise would then depend on it.
        order = rng.permutation(len(x0))
        some = to_numpy(x1)[order]
        cost = pairing_cost(x0, some) if self.plan == "exact" else -self._entropic(x0, some)
        return Match(rows, order[exact_permutation(cost)][rows])

    def _entropic(self, x0: Tensor, x1: Tensor | Array) -> Array:
        return sinkhorn_plan(squared_distances(x0, x1), regularization=self.regularization)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """All rows of the batch."""
        return float(len(x1))
