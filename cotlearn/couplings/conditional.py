"""Conditional optimal transport: the plan pays for a change of condition."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.base import Coupling, Match, array_distances, squared_distances, to_numpy
from cotlearn.couplings.optimal import MinibatchOT
from cotlearn.validation import check_choice, check_condition, check_number, check_same_rows

LABELS = ("target", "source")
BALANCED = "balanced"


class ConditionalOT(Coupling):
    """COT: cost |x0 - x1|^2 + w |c0 - c|^2, where c0 is a random permutation of the batch's c.

    Each noise row gets a condition c0 of its own; the plan then pairs (x0, c0) with (x1, c). At
    w = 0 this is naive minibatch OT. As w grows noise stays within its condition, so that
    p(x0 | c) is the prior again. At w = infinity rows pair only with equal conditions: the exact
    plan of each class for labels, and the independent coupling if every c is different.
    One parametrisation serves all papers: w = g^2 (COT Policy 2505.01179) = beta^2 (Chemseddine
    2403.18705) = 1/eps (Kerrigan 2404.04240).

    Args:
        condition_weight: w, at least 0, or math.inf; or "balanced", COT Policy's rule for each
            batch: w = g^2 with g = 10 mean|x0_i - x1_j| / mean|c0_i - c_j| (distances not
            squared), so that the condition's cost is about 100 times the sample's.
        label: "target" (COT Policy, C2OT): the network is given the condition of x1, which keeps
            p(x1 | c) exact and skews the prior. "source" (Chemseddine's code): it is given c0,
            which keeps the prior exact and smears the data over nearby conditions.
        condition: what the coupling sees of c, a function (n, k) -> (n, m): a fitted
            `KMeansCondition`, for instance. The network is always given c itself.
        plan: as in `MinibatchOT`.
        sampling: as in `MinibatchOT`.
        regularization: as in `MinibatchOT`.

    Raises:
        ValueError: a weight below 0 or NaN, or an unknown option.
    """

    name = "conditional_ot"
    uses_ot_batch = True
    needs_condition = True

    def __init__(
        self,
        condition_weight: float | str = BALANCED,
        *,
        label: str = "target",
        condition: Callable[[Tensor], Tensor] | None = None,
        plan: str = "exact",
        sampling: str = "permutation",
        regularization: float = 0.05,
    ) -> None:
        if isinstance(condition_weight, str):
            check_choice(condition_weight, "condition_weight", (BALANCED,))
        else:
            condition_weight = check_number(condition_weight, "condition_weight", infinite=True)
        self.condition_weight = condition_weight
        self.label = check_choice(label, "label", LABELS)
        if condition is not None and not callable(condition):
            raise TypeError(f"condition must be a function of c, got {condition!r}")
        self.condition = condition
        self.solver = MinibatchOT(plan=plan, sampling=sampling, regularization=regularization)

    @classmethod
    def from_gamma(cls, gamma: float, **options: Any) -> ConditionalOT:
        """COT Policy's g (2505.01179): w = gamma^2."""
        return cls(check_number(gamma, "gamma", infinite=True) ** 2, **options)

    @classmethod
    def from_beta(cls, beta: float, **options: Any) -> ConditionalOT:
        """Chemseddine's beta (2403.18705): w = beta^2."""
        return cls(check_number(beta, "beta", infinite=True) ** 2, **options)

    @classmethod
    def from_epsilon(cls, epsilon: float, **options: Any) -> ConditionalOT:
        """Kerrigan's epsilon (2404.04240): w = 1 / epsilon; 0 pairs within equal conditions."""
        epsilon = check_number(epsilon, "epsilon")
        return cls(1 / epsilon if epsilon else math.inf, **options)

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Give the noise its conditions c0, then pair (x0, c0) with (x1, c)."""
        assert c is not None
        numbers = check_condition(c)
        if self.condition is not None:
            numbers = check_condition(self.condition(numbers), "condition(c)")
            check_same_rows(numbers, "condition(c)", c, "c")
        own = rng.permutation(len(x0))  # c0 = c[own]
        if self.condition_weight == math.inf:
            match = self._within_classes(squared_distances(x0, x1), numbers, own, rng)
        else:
            cost = self._joint_cost(x0, x1, numbers, own)
            match = self.solver.pair(cost, rng)
        if self.label == "target":
            return match
        label = torch.from_numpy(own[match.source_index]).to(c.device)
        return match._replace(c=c[label])

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Rows whose condition costs no more than an average sample distance."""
        self.check_batch(x0, x1, c)
        assert c is not None
        numbers = check_condition(c)
        if self.condition is not None:
            numbers = check_condition(self.condition(numbers), "condition(c)")
            check_same_rows(numbers, "condition(c)", c, "c")
        cost, sample_cost = self.condition_cost(numbers, numbers), squared_distances(x0, x1)
        if self.condition_weight == math.inf:
            return float((cost == 0).sum(axis=1).mean())
        own = np.random.default_rng(0).permutation(len(cost))  # the rows may be pairs already
        weight = self.weight(sample_cost, cost, own)
        return float((weight * cost <= sample_cost.mean()).sum(axis=1).mean())

    def condition_cost(self, c0: Tensor, c: Tensor) -> NDArray[np.float64]:
        """What it costs to change condition: |c0_i - c_j|^2, shape (B, B)."""
        return squared_distances(c0, c)

    def weight(
        self,
        sample_cost: NDArray[np.float64],
        condition_cost: NDArray[np.float64],
        own: NDArray[np.int64],
    ) -> float:
        """The condition weight of this batch, whose noise row i has the condition of row own[i]."""
        if not isinstance(self.condition_weight, str):
            return self.condition_weight
        spread = np.sqrt(condition_cost).mean()
        if spread == 0:  # all conditions are equal: no weight changes anything
            return 0.0
        return float((10 * np.sqrt(sample_cost).mean() / spread) ** 2)

    def _joint_cost(
        self, x0: Tensor, x1: Tensor, c: Tensor, own: NDArray[np.int64]
    ) -> NDArray[np.float64]:
        """|x0_i - x1_j|^2 + w C(c0_i, c_j), shape (B, B), with c0 = c[own]."""
        with np.errstate(over="ignore"):
            if isinstance(self.condition_weight, str):
                c0 = c[torch.from_numpy(own)]
                sample_cost, condition_cost = squared_distances(x0, x1), self.condition_cost(c0, c)
                weight = self.weight(sample_cost, condition_cost, own)
                cost = weight * condition_cost
                cost += sample_cost
                mean = float(sample_cost.mean())
            else:  # the distance of the rows with sqrt(w) c appended: one matrix instead of three
                weight = self.condition_weight
                noise, data = to_numpy(x0), to_numpy(x1)
                heavy = math.sqrt(weight) * to_numpy(c)
                cost = array_distances(
                    np.concatenate([noise, heavy[own]], axis=1),
                    np.concatenate([data, heavy], axis=1),
                )
                centre = data.mean(axis=0)
                noise, data = noise - centre, data - centre
                mean = float(np.vdot(noise, noise) + np.vdot(data, data)) / len(data)
        largest = float(cost.max())
        if not math.isfinite(largest):
            raise ValueError(
                f"condition_weight {weight:.3g} makes the condition's cost infinite; "
                "use math.inf to pair within equal conditions"
            )
        warn_if_imprecise(mean, largest, len(cost), weight)
        return cost

    def _within_classes(
        self,
        sample_cost: NDArray[np.float64],
        c: Tensor,
        own: NDArray[np.int64],
        rng: np.random.Generator,
    ) -> Match:
        """w = infinity: one plan for each distinct condition."""
        _, classes = np.unique(to_numpy(c), axis=0, return_inverse=True)
        classes = classes.ravel()
        sources, targets = [], []
        for k in range(classes.max() + 1):
            rows, columns = np.flatnonzero(classes[own] == k), np.flatnonzero(classes == k)
            part = self.solver.pair(sample_cost[np.ix_(rows, columns)], rng)
            sources.append(rows[part.source_index])
            targets.append(columns[part.target_index])
        source, target = np.concatenate(sources), np.concatenate(targets)
        order = rng.permutation(len(source))  # no batch cut from these pairs is of one class
        return Match(source[order], target[order])


def warn_if_imprecise(mean_sample_cost: float, largest: float, rows: int, weight: float) -> None:
    """Say so if rounding of the total cost is no longer small against the sample cost."""
    rounding = np.finfo(np.float64).eps * largest * rows
    if rounding > 1e-3 * mean_sample_cost:
        warnings.warn(
            f"condition_weight {weight:.3g} makes the condition's cost up to {largest:.3g}, so "
            "large that the exact solver cannot resolve the sample's cost "
            f"({mean_sample_cost:.3g} on average); use a smaller weight, or math.inf to pair "
            "within equal conditions",
            RuntimeWarning,
            stacklevel=2,
        )
