"""Pair data as they look from their condition: in its frame, or about its conditional mean."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Last, Match, Pairs, WithOptions, check_like

Transform = Callable[[Tensor, Tensor], Tensor]
OfCondition = Callable[[Tensor], Tensor]

# What `Transformed` takes from the coupling inside.
FLAGS = ("name", "solves", "uses_ot_batch", "whole_data")
METHODS = ("prepare", "epoch_rows", "draw", "state_dict", "load_state_dict")


@dataclass(repr=False)
class Transformed(Coupling):
    """Any coupling, which pairs forward(x1, c) in the place of x1. Which rows meet changes, x1 not.

    What of the data depends on c a coupling may hand to the noise, which then tells the condition.
    A transform that removes a part of that dependence leaves less to hand on. If forward(x1, c)
    does not depend on c at all, even naive OT leaves the prior as it is, and each row can choose
    from the whole batch, instead of from the few rows whose condition is near.

    - A frame. Where the condition holds a direction, say of an object that is to be pushed, the
      data turn with it. Give the turn into that frame, and its inverse: noise is drawn in the
      frame, paired there, and turned back with its data. For x0 given c to stay the prior both
      must be orthogonal for every c (a rotation, a reflection, a permutation of columns), and the
      noise standard normal or otherwise invariant to them.
    - A conditional mean: see `centred`.

    Args:
        coupling: that pairs; `name`, flags and state of this one are its own. Not one that asks
            a network or a teacher, which know x as it is, nor one that keeps the source's label.
        forward: (x1, c) -> what is paired, both (B, d).
        inverse: (x0, c) -> x0, the noise (B, d) out of the frame; None: noise stays as it is.

    Raises:
        TypeError: not a coupling, or no functions; in use: data without a condition.
        ValueError: a coupling that cannot be wrapped; in use: values that are not finite or of
            another shape, or lengths that change though there is an inverse.
    """

    coupling: Coupling
    forward: Transform
    inverse: Transform | None = None

    needs_condition = True

    def __post_init__(self) -> None:
        inner = self.coupling
        if not isinstance(inner, Coupling):
            raise TypeError(f"coupling must be a Coupling, got {inner!r}")
        if not inner.transformable or getattr(inner, "label", "target") != "target":
            raise ValueError(
                "coupling must choose rows of a batch by x1 and c alone, and label them by their "
                f"data: not a network's or teacher's, nor SemidiscreteOT; got {inner!r}"
            )
        for name, function in (("forward", self.forward), ("inverse", self.inverse)):
            if not callable(function) and (name == "forward" or function is not None):
                raise TypeError(f"{name} must be a function (x, c) -> x, got {function!r}")
        for name in (*FLAGS, *METHODS):
            setattr(self, name, getattr(inner, name))
        self._last = Last()

    def __call__(
        self,
        x0: Tensor,
        x1: Tensor,
        c: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Pairs:
        """Pair a batch; x0 (B, d) is noise as the coupling inside has it, x1 (B, d) plain data."""
        pairs = super().__call__(x0, x1, c, generator)
        if self.inverse is None or pairs.c is None:
            return pairs
        return replace(pairs, x0=self._apply("inverse", pairs.x0, pairs.c))

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """As the coupling inside matches noise and transformed data."""
        seen = self._last(lambda x1, c: self._apply("forward", x1, c), x1, c)
        return self.coupling.match(x0, seen, c, rng)

    def candidates(self, x0: Tensor, x1: Tensor, c: Any = None) -> float:
        """Those of the coupling inside, for noise x0 as `stream` gives it."""
        noise = x0 if self.inverse is None else self._apply("forward", x0, c)
        return self.coupling.candidates(noise, self._apply("forward", x1, c), c)

    def _apply(self, name: str, x: Tensor, c: Tensor) -> Tensor:
        with torch.no_grad():
            values = check_like(getattr(self, name)(x, c), f"{name}(x, c)", x)
        if self.inverse is None:
            return values
        before, after = x.double().norm(dim=1), values.double().norm(dim=1)
        worst = float((after - before).abs().max())
        if worst > 1e-3 * float(before.max()):
            raise ValueError(
                f"{name} must keep the length of every row, as rotations do, so that noise stays "
                f"the prior; a length changed by {worst:.3g}"
            )
        return values


def centred(
    coupling: Coupling, mean: OfCondition, spread: OfCondition | None = None
) -> Transformed:
    """Any coupling, which pairs noise with residuals (x1 - mean(c)) / spread(c).

    In a location-scale family with its true mean and spread the residuals do not depend on c: even
    naive OT leaves the prior as it is and, as the batch grows, becomes conditional OT itself, for
    among rows of one condition subtracting a mean, and dividing by one number for all columns, does
    not change which pairing is the cheapest.

    `StratifiedOT(residual=True)` does this with a linear regression inside each stratum; here the
    regression is one for all data: take a network like the flow's own, trained before with the
    mean squared error (`flows.diffusion.predict`). Where it errs, noise follows its error, and a
    poor mean is worse than none: on Push-T a quadratic one, which leaves half of the variance,
    costs up to .17 of coverage where a network's gains .21 (notebook 08). No number known before
    training predicted that; `linear_skew` with `cells` at least tells a poor mean from a good one,
    which by columns and squares it does not. What else depends on c, such as which modes there
    are, is skewed as before.

    Args:
        coupling: that pairs, see `Transformed`.
        mean: c (B, k) -> the conditional mean of x1, (B, d).
        spread: c (B, k) -> its standard deviation, positive, (B, 1) or (B, d); None: 1.

    Raises:
        TypeError: not a coupling, or no functions.
        ValueError: as `Transformed`; in use: a spread that is not positive.
    """
    for name, function in (("mean", mean), ("spread", spread)):
        if not callable(function) and (name == "mean" or function is not None):
            raise TypeError(f"{name} must be a function of c, got {function!r}")
    return Transformed(coupling, Residual(mean, spread))


@dataclass(frozen=True, repr=False)
class Residual(WithOptions):
    """(x1 - mean(c)) / spread(c): what `centred` pairs."""

    mean: OfCondition
    spread: OfCondition | None = None

    def __call__(self, x1: Tensor, c: Tensor) -> Tensor:
        """The residuals (B, d) of data (B, d)."""
        residual = x1 - check_like(self.mean(c), "mean(c)", x1).to(x1)
        if self.spread is None:
            return residual
        spread = self.spread(c)
        check_like(spread, "spread(c)", x1[:, :1] if np.shape(spread)[1:] == (1,) else x1)
        if not (spread > 0).all():
            raise ValueError(f"spread must be positive, got {float(spread.min()):.3g}")
        return residual / spread.to(x1)
