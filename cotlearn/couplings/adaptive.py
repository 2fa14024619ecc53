"""C2OT: conditional OT that finds a condition weight for each batch."""

import warnings
from bisect import bisect_left
from dataclasses import dataclass, field

import numpy as np

from cotlearn.couplings.base import Array, Index
from cotlearn.couplings.conditional import ConditionalOT
from cotlearn.validation import check_number

RESOLUTION = 16  #: weights are powers of 2^(1/16): 4 % apart
GRID = range(-200 * RESOLUTION, 1000 * RESOLUTION)  #: exponents of the weights, in sixteenths


@dataclass(repr=False)
class AdaptiveConditionalOT(ConditionalOT):
    """C2OT (Cheng & Schwing 2503.10636): cost |x0_i - x1_j|^2 + w |c_i - c_j|^2.

    For each batch, w is the smallest weight whose share of candidates
    r(w) = mean_ij [ M_ij + w C_ij <= M_jj ] is at most `target_ratio`. M is the sample cost, C the
    condition cost, and M_jj the cost of data row j with the noise row that has the same condition.
    r falls from r(0), about 1/2, to r(infinity), which counts only equal conditions. Weights lie on
    a grid of powers of 2^(1/16).

    r(infinity) is about 1/B where all conditions differ, and (1/K + 1/B)/2 for K balanced labels.
    Where it is above the target, as in the small last batch of an epoch, w is the smallest weight
    that reaches r(infinity); the coupling says so once (UserWarning).

    C2OT compares image features by cosine distance, which is half the squared distance of unit
    vectors; to do the same, pass `condition=torch.nn.functional.normalize`.

    Args:
        target_ratio: largest share of candidates, in (0, 1) (paper: 0.05 on moons, 0.2 on images).
        label: as in `ConditionalOT`.
        condition: as in `ConditionalOT`.

    Raises:
        ValueError: target_ratio lies outside (0, 1).
    """

    condition_weight: float | str = field(default="adaptive", init=False)
    target_ratio: float = 0.05

    name = "adaptive"
    rules = ("adaptive",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_ratio()
        self._warned = False

    def _check_ratio(self) -> None:
        if not 0 < check_number(self.target_ratio, "target_ratio") < 1:
            raise ValueError(f"target_ratio must lie between 0 and 1, got {self.target_ratio}")

    def weight(
        self, sample_cost: Array, condition_cost: Array, noise_condition_index: Index
    ) -> float:
        """The smallest weight on the grid with r(w) <= goal; 0 if r(0) is small enough.

        The goal is target_ratio, or r(infinity) where that is larger.
        """
        self._check_ratio()  # it may have been set since
        partner = np.argsort(noise_condition_index)  # the noise row that has condition j
        slack = sample_cost[partner, np.arange(len(partner))] - sample_cost  # M_jj - M_ij

        def ratio(weight: float) -> float:
            return float((weight * condition_cost <= slack).mean())

        if ratio(0.0) <= self.target_ratio:
            return 0.0
        lowest = float(((condition_cost == 0) & (slack >= 0)).mean())
        if lowest > self.target_ratio and not self._warned:
            self._warned = True
            warnings.warn(
                f"target_ratio {self.target_ratio:g} cannot be met: even an infinite weight leaves "
                f"r(infinity) = {lowest:.4g} of this batch of {len(slack)} (pairs of equal "
                "conditions, each row's own among them); its weight leaves no others. If this is "
                "not a small last batch, raise target_ratio, take larger batches, or use "
                "ConditionalOT(math.inf)",
                stacklevel=7,
            )
        goal = max(self.target_ratio, lowest)
        found = bisect_left(GRID, True, key=lambda k: ratio(2.0 ** (k / RESOLUTION)) <= goal)
        if found == len(GRID):
            raise ValueError(
                "x1 and c are in units so different that no weight of the search joins them: "
                "standardise both"
            )
        return float(2.0 ** (GRID[found] / RESOLUTION))
