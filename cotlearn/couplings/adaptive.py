"""C2OT: conditional OT whose weight is found for each batch."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.base import squared_distances
from cotlearn.couplings.conditional import ConditionalOT
from cotlearn.validation import check_choice, check_number

COSTS = ("squared", "cosine")
RESOLUTION = 16  #: weights are powers of 2^(1/16): 4 % apart
LOWEST = -200 * RESOLUTION  #: the smallest weight looked at is 2^-200


class AdaptiveConditionalOT(ConditionalOT):
    """C2OT (Cheng & Schwing 2503.10636): cost |x0_i - x1_j|^2 + w C(c_i, c_j).

    For each batch w is the smallest weight for which the share of candidates
    r(w) = mean_ij [ M_ij + w C_ij <= M_jj ] is at most the target, M being the sample cost and
    M_jj that of data j with the noise of its own condition. r falls from r(0), about 1/2, to
    r(infinity), which counts only equal conditions. Weights lie on a grid of powers of 2^(1/16),
    so that w is a function of the batch alone, and the warm start from the last batch's weight
    saves only time.

    Args:
        target_ratio: the share of candidates, in (0, 1) (paper: 0.05 on moons, 0.2 on images).
        cost: "squared" distance of conditions, or "cosine" distance.
        label: as in `ConditionalOT`.
        condition: as in `ConditionalOT`.
        plan: as in `MinibatchOT`.
        sampling: as in `MinibatchOT`.
        regularization: as in `MinibatchOT`.

    Raises:
        ValueError: target_ratio outside (0, 1); at a batch, a target below r(infinity).
    """

    name = "adaptive"

    def __init__(
        self,
        target_ratio: float = 0.05,
        *,
        cost: str = "squared",
        label: str = "target",
        condition: Callable[[Tensor], Tensor] | None = None,
        plan: str = "exact",
        sampling: str = "permutation",
        regularization: float = 0.05,
    ) -> None:
        super().__init__(
            0.0,
            label=label,
            condition=condition,
            plan=plan,
            sampling=sampling,
            regularization=regularization,
        )
        if not 0 < check_number(target_ratio, "target_ratio") < 1:
            raise ValueError(f"target_ratio must lie between 0 and 1, got {target_ratio}")
        self.target_ratio = float(target_ratio)
        self.cost = check_choice(cost, "cost", COSTS)
        self.condition_weight = "adaptive"  # see `weight`
        self._last = 0  # grid position of the last positive weight

    @classmethod
    def from_target_ratio(cls, target_ratio: float, **options: object) -> AdaptiveConditionalOT:
        """C2OT's target ratio (2503.10636)."""
        return cls(target_ratio, **options)  # type: ignore[arg-type]

    def condition_cost(self, c0: Tensor, c: Tensor) -> NDArray[np.float64]:
        """C(c0_i, c_j), shape (B, B); the conditions that came in are not changed."""
        if self.cost == "squared":
            return squared_distances(c0, c)
        if not (c.any(dim=1).all() and c0.any(dim=1).all()):
            raise ValueError("cost 'cosine' needs a direction, but rows of the condition c are 0")
        unit0, unit = (torch.nn.functional.normalize(v.double(), dim=1) for v in (c0, c))
        similarity = (unit0 @ unit.T).clamp(-1, 1).cpu().numpy()
        distance: NDArray[np.float64] = 1 - similarity
        return np.where(distance < 1e-12, 0.0, distance)  # equal up to rounding is equal

    def weight(
        self,
        sample_cost: NDArray[np.float64],
        condition_cost: NDArray[np.float64],
        own: NDArray[np.int64],
    ) -> float:
        """The smallest weight on the grid with r(w) <= target_ratio; 0 if r(0) is already."""
        partner = np.empty_like(own)
        partner[own] = np.arange(len(own))  # the noise row that has condition j
        slack = sample_cost[partner, np.arange(len(own))] - sample_cost  # M_jj - M_ij

        def ratio(weight: float) -> float:
            return float((weight * condition_cost <= slack).mean())

        if ratio(0.0) <= self.target_ratio:
            return 0.0  # and the last positive weight stays as the next start
        lowest = float(((condition_cost == 0) & (slack >= 0)).mean())
        if lowest > self.target_ratio:
            raise ValueError(
                f"target_ratio {self.target_ratio:g} cannot be met: even an infinite weight leaves "
                f"r(infinity) = {lowest:.4g} of this batch of {len(own)} (pairs of equal "
                "conditions, each row's own among them); raise target_ratio, take a larger batch, "
                "or use ConditionalOT(math.inf)"
            )
        self._last = _smallest(lambda k: ratio(_grid(k)) <= self.target_ratio, self._last)
        return _grid(self._last)


def _grid(k: int) -> float:
    return math.pow(2.0, k / RESOLUTION)


def _smallest(holds: Callable[[int], bool], start: int) -> int:
    """The smallest integer from LOWEST on for which a condition holds that stays true."""
    start = max(start, LOWEST)
    step = RESOLUTION
    if holds(start):
        high, low = start, start - step
        while low > LOWEST and holds(low):
            high, step = low, 2 * step
            low -= step
        if low <= LOWEST:
            if holds(LOWEST):
                return LOWEST
            low = LOWEST
    else:
        low, high = start, start + step
        while not holds(high):
            low, step = high, 2 * step
            high += step
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle, high)
    return high
