"""Pair what a regression on the condition leaves over of the data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Pairs, spelled
from cotlearn.couplings.wrapped import Wrapped

Centre = Callable[[Tensor], Tensor]


class Centred(Wrapped):
    """Any coupling, which sees data as they lie about what their condition foretells.

    The coupling inside pairs noise with (x1 - mean(c)) / spread(c) in the place of x1. Which rows
    meet changes, x1 itself does not. What is left over depends less on c than the data do, so noise
    that is paired with it tells less of c. If it does not depend on c at all, in a location-scale
    family with its true mean and spread, even naive OT leaves the prior as it is and, as the batch
    grows, becomes conditional OT itself: among rows of one condition, taking off a mean and one
    number for the spread of all columns does not change which pairing is the cheapest. And each row
    can choose from the whole batch, instead of from the few rows whose condition is near.

    `StratifiedOT(residual=True)` does this with a linear regression inside each stratum; here the
    regression is one for all data: take a network like the flow's own, trained before with the
    mean squared error (`flows.diffusion.predict`). Where it errs, noise follows its error, and a
    poor mean is worse than none: on Push-T a quadratic one, which leaves half of the variance,
    costs up to .17 of coverage where a network's gains .21 (notebook 08). No number known before
    training foretold that; `linear_skew` with `cells` at least tells a poor mean from a good one,
    which by columns and squares it does not. What else depends on c, such as which modes there
    are, is skewed as before.

    Args:
        coupling: that pairs, see `Wrapped`.
        mean: c (B, k) -> what c foretells of x1, (B, d).
        spread: c (B, k) -> standard deviation about it, positive, (B, 1) or (B, d); None: one.

    Raises:
        TypeError: not a coupling, or no functions; in use: data without a condition.
        ValueError: a coupling that cannot be wrapped; in use: a function whose values have another
            shape, are not finite or, of the spread, not positive.
    """

    def __init__(self, coupling: Coupling, mean: Centre, spread: Centre | None = None) -> None:
        super().__init__(coupling)
        for name, function in (("mean", mean), ("spread", spread)):
            if not callable(function) and not (name == "spread" and function is None):
                raise TypeError(f"{name} must be a function of c, got {function!r}")
        self.mean, self.spread = mean, spread

    def _seen(self, x1: Tensor, c: Tensor) -> Tensor:
        """What is left over of the data."""
        mean, spread = self._foretold(x1, c)
        return (x1 - mean) / spread

    def _restored(self, pairs: Pairs) -> Pairs:
        """With the data as they are."""
        assert pairs.c is not None
        mean, spread = self._foretold(pairs.x1, pairs.c)
        return replace(pairs, x1=mean + spread * pairs.x1)

    def _foretold(self, x1: Tensor, c: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and spread of rows like x1 under the conditions c."""
        with torch.no_grad():
            mean = self.mean(c)
            spread = torch.ones_like(x1[:, :1]) if self.spread is None else self.spread(c)
        _check("mean", mean, [tuple(x1.shape)])
        _check("spread", spread, [(len(x1), 1), tuple(x1.shape)])
        if not (spread > 0).all():
            raise ValueError(f"spread must be positive, got {float(spread.min()):.3g}")
        return mean.to(x1), spread.to(x1)

    def __repr__(self) -> str:
        last = "" if self.spread is None else f", {spelled(self.spread)}"
        return f"Centred({self.coupling!r}, {spelled(self.mean)}{last})"


def _check(name: str, value: object, shapes: list[tuple[int, ...]]) -> None:
    if not isinstance(value, Tensor) or tuple(value.shape) not in shapes:
        got = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        wanted = " or ".join(map(str, dict.fromkeys(shapes)))
        raise ValueError(f"{name} must return values of shape {wanted}, got {got}")
    if not torch.isfinite(value).all():
        raise ValueError(f"{name} must return finite values")
