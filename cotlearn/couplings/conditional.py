"""Conditional optimal transport: the cost includes the distance of the conditions."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import Array, Coupling, Index, Match, Traits, is_ours, lent
from cotlearn.couplings.distances import (
    centred_products,
    hides,
    mean_distance,
    near_rows,
    pairing_cost,
    squared_distances,
    to_numpy,
    weigh,
)
from cotlearn.couplings.unheeded import warn_if_one_column_rules, warn_if_unheeded
from cotlearn.couplings.units import in_own_units

FEW = 16  #: rows below which all labels of a batch may differ by chance


def _squared(value: float, name: str) -> float:
    """The square of a number from 0 to infinity, itself infinite where float64 does not hold it."""
    number = validation.check_number(value, name, infinite=True)
    return number * number  # `**` raises an error


@dataclass(repr=False)
class ConditionalOT(Coupling):
    """COT: cost |x0 - x1|^2 + w |c0 - c|^2, where c0 is a random permutation of the batch's c.

    Each noise row gets a condition c0; the plan then pairs (x0, c0) with (x1, c). At w = 0 this is
    naive minibatch OT. As w grows, noise is paired within its condition, and p(x0 | c) approaches
    the prior. At w = infinity only rows with equal conditions are paired: for labels this is the
    exact plan of each class; if all c differ, it is the independent coupling (a warning says so).
    Labels must be one-hot: numbers of classes in one column are numbers, of which near ones pair.
    The papers use the same weight in other forms: w = g^2 (COT Policy 2505.01179) = beta^2
    (Chemseddine 2403.18705) = 1/eps (Kerrigan 2404.04240).

    Args:
        condition_weight: w, at least 0, or math.inf; or the name of a rule for each batch.
            "balanced" is COT Policy's: w = g^2 with g = 10 mean|x0_i - x1_j| / mean|c0_i - c_j|
            (distances not squared), so that the condition cost is about 100 times the sample cost.
            "scaled" is the same rule on the columns of c in units of their own (see `OwnUnits`):
            force, time and label then count alike. For one-hot labels and for one column without
            outliers the two are one. Where `condition` is given, its columns are left as they are.
        label: "target" (COT Policy, C2OT): the network is given the condition of x1, which keeps
            p(x1 | c) exact and skews the prior. "source" (Chemseddine's code): it is given c0,
            which keeps the prior exact and smears the data over nearby conditions.
        condition: maps c (n, k) to the condition (n, m) in the cost, for instance a fitted
            `KMeansCondition`. The network is always given c itself.

    Raises:
        TypeError: condition is not callable; when pairing, c is None.
        ValueError: condition_weight is negative or NaN, or an option is unknown; when pairing,
            condition is a network with dropout or batch normalisation that is not in eval mode.

    Warns (UserWarning) if one column of several carries nearly all of the condition cost, or if a
    rule's pairs hardly heed a column.
    """

    condition_weight: float | str = "scaled"
    _: KW_ONLY
    label: str = "target"
    condition: Callable[[Tensor], Tensor] | None = None

    name = "conditional_ot"
    traits = Traits(needs_condition=True, uses_ot_batch=True)
    rules: ClassVar[tuple[str, ...]] = (
        "scaled",
        "balanced",
    )  #: names of rules that choose a weight for each batch

    def __post_init__(self) -> None:
        self._check_options()
        if self.label == "source":
            self.traits = replace(self.traits, transformable=False)
        if self.condition is not None:
            validation.check_function(self.condition, "condition", "of c")

    def _check_options(self) -> None:
        """They may have been set since."""
        weight, name = self.condition_weight, "condition_weight"
        if isinstance(weight, str):
            also = "a number from 0 to math.inf, or "
            validation.check_choice(weight, name, self.rules, also)
        else:
            self.condition_weight = validation.check_number(weight, name, infinite=True)
        validation.check_choice(self.label, "label", ("target", "source"))

    @classmethod
    def from_gamma(cls, gamma: float, **options: Any) -> ConditionalOT:
        """COT Policy's g (2505.01179): w = gamma^2."""
        return cls(_squared(gamma, "gamma"), **options)

    @classmethod
    def from_beta(cls, beta: float, **options: Any) -> ConditionalOT:
        """Chemseddine's beta (2403.18705): w = beta^2."""
        return cls(_squared(beta, "beta"), **options)

    @classmethod
    def from_epsilon(cls, epsilon: float, **options: Any) -> ConditionalOT:
        """Kerrigan's epsilon (2404.04240): w = 1 / epsilon; 0 pairs within equal conditions."""
        epsilon = validation.check_number(epsilon, "epsilon")
        return cls(1 / epsilon if epsilon else math.inf, **options)

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """Draw the conditions c0 of the noise, then pair (x0, c0) with (x1, c)."""
        self._check_options()
        seen = self._seen_of(c)
        noise_condition_index = rng.permutation(len(x0))  # c0 = c[noise_condition_index]
        mixed = rng.permutation(len(x0))
        # Solvers deal equal columns by their places, see `MinibatchOT`: costs of rows with unlike c
        # can be equal, as for a small weight.
        order = rng.permutation(len(x0))
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        own = place[noise_condition_index]  # c0 among the shuffled
        noise, data, seen = to_numpy(x0), to_numpy(x1)[order], seen[order]
        if self._is_infinite():
            cost = pairing_cost(noise, data)
            source, target = _within_classes(cost, torch.from_numpy(seen), own)
            source, target = source[mixed], target[mixed]  # batches cut from them mix the classes
        else:
            source = np.arange(len(x0))
            if self.condition is not None or self.condition_weight != "scaled":
                validation.check_squares(c=torch.from_numpy(seen))
            if self.condition_weight and self.condition_weight != "scaled":
                warn_if_one_column_rules(torch.from_numpy(seen))
            target = exact_permutation(self._joint_cost(noise, data, seen, own, order))
            if self.condition_weight in ConditionalOT.rules:  # a target ratio leaves more
                warn_if_unheeded(seen, own, target)
        labels = noise_condition_index[source] if self.label == "source" else None
        return Match(source, order[target], labels)

    def candidates(self, x0: Tensor, x1: Tensor, c: Any = None) -> float:
        """Rows whose condition cost is at most the mean sample cost."""
        seen = self._seen_of(validation.check_condition(c))
        cost, sample_cost = squared_distances(seen, seen), squared_distances(x0, x1)
        if self._is_infinite():
            return float((cost == 0).sum(axis=1).mean())
        shuffled = np.random.default_rng(0).permutation(len(cost))  # x0 and x1 may be paired
        weight = self._checked_weight(sample_cost, cost, shuffled, np.arange(len(cost)))
        return near_rows(weight, cost, sample_cost)

    def weight(
        self, sample_cost: Array, condition_cost: Array, noise_condition_index: Index
    ) -> float:
        """The condition weight of a batch. In a subclass with its own, the option does not count.

        Args:
            sample_cost: (B, B), |x0_i - x1_j|^2.
            condition_cost: (B, B), |c0_i - c_j|^2.
            noise_condition_index: (B,), c0 = c[noise_condition_index].
        """
        if not isinstance(self.condition_weight, str):
            return self.condition_weight
        spread = mean_distance(condition_cost)
        if spread == 0:  # all conditions are equal: no weight changes anything
            return 0.0
        return float((10 * mean_distance(sample_cost) / spread) ** 2)

    def _is_infinite(self) -> bool:
        return self.condition_weight == math.inf and is_ours(self.weight)

    def _checked_weight(
        self, sample_cost: Array, condition_cost: Array, noise_condition_index: Index, order: Index
    ) -> float:
        """What `weight` says; a user's one may be wrong, and overwrite what it is given.

        Columns are shuffled by `order` (B,); a user's weight sees them in the order of the batch.
        """
        if is_ours(self.weight):
            return self.weight(sample_cost, condition_cost, noise_condition_index)
        back = np.argsort(order)
        costs = sample_cost[:, back], condition_cost[:, back]  # copies
        weight = self.weight(*costs, order[noise_condition_index])
        return validation.check_number(weight, "weight(...)")

    def _seen_of(self, c: Tensor) -> Array:
        """The conditions in the cost, (B, m)."""
        if self.condition is None:
            return in_own_units(c) if self.condition_weight == "scaled" else to_numpy(c)
        what_happens = "a condition gets other values each time"
        validation.check_draws_nothing(self.condition, "condition", what_happens)
        name, seen = "condition(c)", self.condition(*lent(validation.check_condition(c)))
        seen = validation.check_condition(seen, name)
        validation.check_same_rows(seen, name, c, "c")
        return to_numpy(seen)

    def _joint_cost(
        self, noise: Array, data: Array, c: Array, noise_condition_index: Index, order: Index
    ) -> Array:
        """|x0_i - x1_j|^2 + w C(c0_i, c_j), shape (B, B), with c0 = c[noise_condition_index].

        The rows of the data and of c are those of the batch in the given order (B,).
        """
        if isinstance(self.condition_weight, str) or not is_ours(self.weight):
            sample_cost = squared_distances(noise, data)
            cost = squared_distances(c[noise_condition_index], c)
            weight = self._checked_weight(sample_cost, cost, noise_condition_index, order)
            if hides(sample_cost, noise, data):
                sample_cost = centred_products(noise, data)
            mean = weigh(cost, weight, sample_cost)
        else:  # the distance of the rows with sqrt(w) c appended: one matrix instead of three
            weight = self.condition_weight
            with np.errstate(over="ignore"):
                heavy = math.sqrt(weight) * c
            joint = np.hstack([noise, heavy[noise_condition_index]])
            cost = pairing_cost(joint, np.hstack([data, heavy]))
            centre = data.mean(axis=0)
            mean = sum(float(np.square(x - centre).sum()) for x in (noise, data)) / len(data)
        largest = float(cost.max())
        if not math.isfinite(largest):
            raise ValueError(f"condition_weight {weight:.3g} makes costs infinite: use math.inf")
        warn_if_imprecise(mean, largest, len(cost), weight)
        return cost


def _within_classes(
    sample_cost: Array, c: Tensor, noise_condition_index: Index
) -> tuple[Index, Index]:
    """w = infinity: one plan for each distinct condition."""
    label = torch.unique(c, dim=0, return_inverse=True)[1].cpu().numpy()
    if label.max() + 1 == len(c) >= FEW:
        warnings.warn(
            f"each of the {len(c)} rows has a condition of its own, so that all pairs are random: "
            "condition_weight math.inf is for labels, take a finite one",
            stacklevel=2,
        )
    sources, targets = [], []
    for k in range(label.max() + 1):
        rows = np.flatnonzero(label[noise_condition_index] == k)
        columns = np.flatnonzero(label == k)
        sources.append(rows)
        targets.append(columns[exact_permutation(sample_cost[np.ix_(rows, columns)])])
    return np.concatenate(sources), np.concatenate(targets)


def warn_if_imprecise(mean_sample_cost: float, largest: float, rows: int, weight: float) -> None:
    """Warn if rounding errors of the total cost are not small against the sample cost."""
    if np.finfo(np.float64).eps * largest * rows > 1e-3 * mean_sample_cost:
        warnings.warn(
            f"condition_weight {weight:.3g} makes the condition cost up to {largest:.3g}, so large "
            f"that rounding hides the sample cost ({mean_sample_cost:.3g} on average); use a "
            "smaller weight, or pair within equal conditions: math.inf, or clusters",
            RuntimeWarning,
            stacklevel=2,
        )
