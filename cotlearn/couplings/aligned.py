"""Model-aligned coupling (MAC): the model's own error decides which pairs it trains on."""

from dataclasses import KW_ONLY, dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cotlearn import validation
from cotlearn.couplings.assignment import exact_permutation, sinkhorn_plan
from cotlearn.couplings.base import Array, Coupling, Index, Match, Traits, lent
from cotlearn.couplings.distances import near_rows, squared_distances
from cotlearn.couplings.unheeded import warn_if_one_column_rules

LIMIT = 64  #: most distinct conditions in a "full" batch, which needs B evaluations for each


@dataclass(repr=False)
class ModelAligned(Coupling):
    """Three algorithms called MAC (Lin 2505.23346), scored by the EMA network.

    The error of a pair is |v(t, x_t, c) - (x1 - x0)|^2, averaged over t in {0, 1}.

    - "weighted" (the authors' default): keep the batch's random pairs. The share `fraction` with
      the lowest error gets weight 1 + boost, the rest weight 1; weights are scaled to mean 1.
    - "topk" (the paper's abstract): train only on that share; all other pairs get weight 0. So the
      noise that is trained is not the prior, and depends on the condition; with "weighted", less.
    - "full": take the B x B errors as cost, compute a Sinkhorn plan whose regularisation falls
      from `regularization[0]` to `regularization[1]`, and use the permutation with the largest
      sum of plan entries. This pairs across conditions and so has naive OT's skew, unless
      `condition_weight` w adds w |c_i - c_j|^2 to the cost.

    Over `warmup_steps` the selected share falls linearly from 1 to `fraction`, and the
    regularisation from its first to its last value (authors: 20,000 steps; use the same share of
    your training).

    Args:
        variant: "weighted", "topk" or "full".
        fraction: share of the pairs to select, in (0, 1] (authors: 0.4).
        boost: the paper's lambda, at least 0 (authors: 0.5; 1 on images).
        warmup_steps: gradient steps, at least 0.
        regularization: first and last value, both above 0, in standard deviations of the costs.
        condition_weight: w, at least 0; for "full" only.

    Raises:
        ValueError: an option is out of range; pairs are made before `observe` was called; a "full"
            batch has more than 64 distinct conditions.
    """

    variant: str = "weighted"
    _: KW_ONLY
    fraction: float = 0.4
    boost: float = 0.5
    warmup_steps: int = 1000
    regularization: tuple[float, float] = (2.0, 0.2)
    condition_weight: float = 0.0

    name = "aligned"
    traits = Traits(needs_network=True, transformable=False)

    def __post_init__(self) -> None:
        self._check_options()
        if self.condition_weight > 0:
            self.traits = replace(self.traits, needs_condition=True)
        self._network: Any = None
        self._step = 0
        self.evaluations = 0  #: rows of the network evaluated for the last batch

    def _check_options(self) -> None:
        validation.check_choice(self.variant, "variant", ("weighted", "topk", "full"))
        validation.check_positive(validation.check_share(self.fraction, "fraction"), "fraction")
        validation.check_number(self.boost, "boost")
        validation.check_count(self.warmup_steps, "warmup_steps", minimum=0)
        for value in validation.check_array(self.regularization, "regularization", (2,)):
            validation.check_positive(value, "regularization")
        weight = validation.check_number(self.condition_weight, "condition_weight")
        if weight and self.variant != "full":
            raise ValueError("condition_weight is for variant 'full': the others pair i with i")

    def observe(self, network: nn.Module, step: int) -> None:
        """Score with `network` from now on; `step` drives the warm-up.

        Raises:
            ValueError: the network is in train mode, and has dropout or normalises by its batch.
        """
        self._network, self._step = network, step
        self._check_network()

    def _check_network(self) -> None:
        what_happens = "a pair gets other errors each time"
        validation.check_draws_nothing(self._network, "network", what_happens)

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Weigh the batch's own pairs, or assign by the errors of all pairs."""
        if self._network is None:
            raise ValueError("no network yet: call observe(network, step) before pairing")
        self._check_options()  # they may have been set since, and somebody may train the network
        self._check_network()
        rows = np.arange(len(x0))
        if self.variant == "full":
            return Match(rows, self._assign(x0, x1, c))
        errors = self.row_errors(x0, x1, c)
        share = self._falling(1.0, self.fraction)
        chosen = max(1, int(len(x0) * share + 1e-9))  # floor(B p): 10 * 0.2 must not be 1.99...
        order = errors.argsort()
        weight = torch.full_like(errors, 0.0 if self.variant == "topk" else 1.0)
        weight[order[:chosen]] = 1.0 if self.variant == "topk" else 1.0 + self.boost
        return Match(rows, rows, weight=weight / weight.mean())

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """1, except for "full": all rows, or those with near conditions if they have a weight."""
        if self.variant != "full":
            return 1.0
        same = torch.zeros(len(x0), 1) if c is None else c
        cost = squared_distances(same, same)
        return near_rows(self.condition_weight, cost, squared_distances(x0, x1))

    def row_errors(self, x0: Tensor, x1: Tensor, c: Tensor | None) -> Tensor:
        """The error of pair (x0_i, x1_i, c_i), shape (B,)."""
        self.evaluations = 2 * len(x0)
        target = x1 - x0
        start, end = (self._velocity(t, x, c) - target for t, x in ((0.0, x0), (1.0, x1)))
        return start.square().sum(dim=1) / 2 + end.square().sum(dim=1) / 2

    def errors(self, x0: Tensor, x1: Tensor, c: Tensor | None) -> Array:
        """The error of every pair (x0_i, x1_j, c_j), shape (B, B).

        At t = 1 the network evaluates (x1_j, c_j), B rows. At t = 0 it evaluates (x0_i, c_j): B
        rows for each distinct condition, at most B^2.
        """
        seen = torch.zeros(len(x0), 1) if c is None else c
        distinct, label = torch.unique(seen, dim=0, return_inverse=True)
        if len(distinct) > LIMIT:
            raise ValueError(
                f"variant 'full' has {len(distinct)} different conditions to evaluate, at most "
                f"{LIMIT} are allowed: use fewer rows in a batch (ot_batch_size)"
            )
        self.evaluations = len(x0) * (1 + len(distinct))
        # |v(0, x0_i, c_j) - (x1_j - x0_i)|^2 = |(x0_i + v(0, x0_i, c_j)) - x1_j|^2
        start = np.empty((len(x0), len(x1)))
        for k, row in enumerate(distinct):
            columns = (label == k).cpu()
            shared = None if c is None else row.expand(len(x0), -1)
            landed = x0 + self._velocity(0.0, x0, shared)
            start[:, columns.numpy()] = squared_distances(landed, x1[columns])
        # |v(1, x1_j, c_j) - (x1_j - x0_i)|^2 = |x0_i - (x1_j - v(1, x1_j, c_j))|^2
        end = squared_distances(x0, x1 - self._velocity(1.0, x1, c))
        return (start + end) / 2

    def _assign(self, x0: Tensor, x1: Tensor, c: Tensor | None) -> Index:
        cost = self.errors(x0, x1, c)
        if self.condition_weight and c is not None:
            warn_if_one_column_rules(c)
            cost = cost + self.condition_weight * squared_distances(c, c)
        spread = cost.std()
        if spread == 0:
            return np.arange(len(cost))
        cost = (cost - cost.min()) / spread
        regularization = self._falling(*self.regularization) / cost.mean()
        return exact_permutation(-sinkhorn_plan(cost, regularization=regularization))

    def _velocity(self, t: float, x: Tensor, c: Tensor | None) -> Tensor:
        weights = next(self._network.parameters(), x)  # for the network's device and dtype
        x, c = lent(x, c)
        moved = None if c is None else c.to(weights)
        return self._network(torch.tensor(t).to(weights), x.to(weights), moved).to(x)

    def _falling(self, first: float, last: float) -> float:
        done = min(1.0, self._step / self.warmup_steps) if self.warmup_steps else 1.0
        return first + (last - first) * done
