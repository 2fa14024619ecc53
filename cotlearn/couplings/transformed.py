"""Couplings of transformed data: in a frame given by the condition, or as residuals."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import (
    Coupling,
    Last,
    Match,
    Pairs,
    Source,
    WithOptions,
    check_like,
    lent,
)
from cotlearn.validation import check_condition, check_draws_nothing, check_function, check_has

LARGE = 2048  #: rows from which transformed values are kept for the next epoch
INVERSE = 1e-2  #: largest error of the inverse, as a share of the longest row
LOOKED_AT = 256  #: rows by which a change of the transform is seen
ROUNDING = 4  #: units in the last place, the rounding error of a value by a sum and a quotient
UNCHANGED = 1e-4  #: largest difference of values that count as equal, as a share of the largest

Transform = Callable[[Tensor, Tensor], Tensor]
OfCondition = Callable[[Tensor], Tensor]


@dataclass(repr=False)
class Transformed(Coupling):
    """Pairs noise with forward(x1, c) instead of x1. This changes which rows are paired, not x1.

    If x1 depends on c, a coupling can make x0 depend on c as well. A transform that removes part of
    the dependence of x1 on c reduces this prior skew. If forward(x1, c) does not depend on c at
    all, even naive OT keeps the prior, and each noise row has the whole batch as candidates instead
    of the few rows with a near condition. Values that differ by rounding count as equal.

    - A frame. If the condition holds a direction, say of an object to push, the data rotate with
      it. Give the rotation into that frame and its inverse: noise is drawn and paired in the frame,
      then rotated back. For p(x0 | c) to stay the prior, both must be orthogonal for every c (a
      rotation, a reflection, a permutation of columns), and the noise must be invariant to them,
      as standard normal noise is.
    - A conditional mean: see `centred`.

    Args:
        coupling: the inner coupling; its `name`, traits and state are used. It must not use a
            network or a teacher, which expect the original x, nor label pairs by their source.
        forward: maps x1 (B, d) and c (B, k) to the values that are paired, (B, d). The values of a
            whole data set are kept, and computed anew when those of 256 of its rows change: a
            forward that changes for a few rows only must be a new `Transformed`.
        inverse: maps noise (B, d) and c from the frame back; if None, noise is not transformed.

    Raises:
        TypeError: coupling is not a `Coupling`, or forward or inverse is not callable; when
            pairing, c is None.
        ValueError: the coupling cannot be wrapped; when pairing, transformed values have another
            shape or are not finite, or there is an inverse and the length of a row changes.
    """

    coupling: Coupling
    forward: Transform
    inverse: Transform | None = None

    def __post_init__(self) -> None:
        inner = check_has(self.coupling, "coupling", "a Coupling", "traits")
        if not inner.traits.transformable:
            raise ValueError(
                "coupling must choose rows of a batch by x1 and c alone, and label them by their "
                f"data: not a network's or teacher's, nor SemidiscreteOT; got {inner!r}"
            )
        check_function(self.forward, "forward", "(x, c) -> x")
        if getattr(inner, "inverse", None) is not None:
            raise ValueError(
                "coupling must not have an inverse of its own, which would be left out: wrap it "
                f"the other way round, Transformed(centred(...), forward, inverse); got {inner!r}"
            )
        if self.inverse is not None:
            check_function(self.inverse, "inverse", "(x, c) -> x")
        self.name, self.traits = inner.name, replace(inner.traits, needs_condition=True)
        self._last = Last()

    def __call__(
        self,
        x0: Tensor,
        x1: Tensor,
        c: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Pairs:
        """Pair a batch: x0 (B, d) is noise in the frame, x1 (B, d) is untransformed data."""
        pairs = super().__call__(x0, x1, c, generator)
        if self.inverse is None or pairs.c is None:
            return pairs
        c = check_condition(pairs.c)
        noise = self._apply("inverse", pairs.x0, c)
        off = (self._apply("forward", noise, c) - pairs.x0).norm(dim=1).max()
        if float(off) > INVERSE * float(pairs.x0.norm(dim=1).max()):
            raise ValueError(
                f"inverse must undo forward: noise came back off by {float(off):.3g}, so the pairs "
                "would not be those of the frame"
            )
        return replace(pairs, x0=noise.to(pairs.x0.dtype))

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """Match noise and transformed data by the inner coupling."""
        seen = self._seen(x1, c)
        return self.coupling.matched(x0, seen, c, rng)

    def _seen(self, x1: Tensor, c: Tensor) -> Tensor:
        """Forward(x1, c); of a data set the last one, unless a few rows show that it changed."""
        if len(x1) < LARGE:
            return self._rounded(x1, c)
        some = slice(None, None, len(x1) // LOOKED_AT)
        now = self._apply("forward", x1[some], c[some])
        seen: Tensor = self._last(self._rounded, x1, c)
        if (now - seen[some]).abs().max() > UNCHANGED * now.abs().max():  # a mean that learns
            self._last = Last()
            seen = self._last(self._rounded, x1, c)
        return seen

    def _rounded(self, x1: Tensor, c: Tensor) -> Tensor:
        """Forward(x1, c), where values that differ by rounding are equal."""
        values = self._apply("forward", x1, c)
        if isinstance(self.forward, Residual):
            return values  # it has done so
        if self.inverse is None:
            return without_rounding(values, x1)
        return without_rounding(values, x1.norm(dim=1, keepdim=True).expand_as(values))

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Prepare the inner coupling."""
        self.coupling.prepare(data, source, generator)

    def prepared(self, data: Any, source: Source | None, generator: torch.Generator) -> Transformed:
        """A copy around what pairs the batches of the inner coupling's stream."""
        own = copy.copy(self)
        own.coupling, own._last = self.coupling.prepared(data, source, generator), Last()
        return own

    def _last_turn(self) -> object:
        return self.coupling._last_turn()

    def epoch_rows(self, data: Any) -> int:
        """The rows of an epoch of the inner coupling."""
        return self.coupling.epoch_rows(data)

    def draw(self, data: Any, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """Draw rows as the inner coupling does."""
        return self.coupling.draw(data, n, generator)

    def state_dict(self) -> dict[str, Tensor]:
        """The state of the inner coupling."""
        return self.coupling.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state of the inner coupling."""
        self.coupling.load_state_dict(state)

    def candidates(self, x0: Tensor, x1: Tensor, c: Any = None) -> float:
        """The candidates of the inner coupling, for noise x0 as `stream` yields it."""
        noise = x0 if self.inverse is None else self._apply("forward", x0, c)
        return self.coupling.candidates(noise, self._apply("forward", x1, c), c)

    def _apply(self, name: str, x: Tensor, c: Tensor) -> Tensor:
        with torch.no_grad():
            values = check_like(getattr(self, name)(*lent(x, c)), f"{name}(x, c)", x)
        if self.inverse is None:
            return values
        before, after = x.double().norm(dim=1), values.double().norm(dim=1)
        worst = float((after - before).abs().max())
        rounding = torch.finfo(x.dtype).eps
        if worst > max(1e-3, 4 * rounding) * float(before.max()):
            raise ValueError(
                f"{name} must keep the length of every row, as rotations do, so that noise stays "
                f"the prior; a length changed by {worst:.3g}"
            )
        return values


def centred(
    coupling: Coupling, mean: OfCondition, spread: OfCondition | None = None
) -> Transformed:
    """Make a coupling pair noise with the residuals (x1 - mean(c)) / spread(c).

    In a location-scale family with its true mean and spread, the residuals do not depend on c. Even
    naive OT then keeps the prior. As the batch grows it becomes conditional OT, because among rows
    of one condition, neither subtracting a mean nor dividing all columns by one number changes the
    optimal pairing.

    `StratifiedOT(residual=True)` uses a linear regression inside each stratum; `centred` uses one
    regression for all data. Use a network like the flow's own, trained beforehand with mean squared
    error (`flows.diffusion.predict`). The noise depends on c through the error of the mean, so a
    poor mean is worse than none: on Push-T a quadratic one, which leaves half of the variance,
    costs up to .17 of coverage, while a network gains .21 (laboratory 08). No number known before
    training predicted this; `linear_skew` with `cells` at least tells a poor mean from a good one,
    which it does not with polynomial features. Any other dependence on c, such as the number of
    modes, is skewed as before.

    Args:
        coupling: the inner coupling, see `Transformed`.
        mean: maps c (B, k) to the conditional mean of x1, (B, d).
        spread: maps c (B, k) to a positive standard deviation of x1, (B, 1) or (B, d); 1 if None.

    Returns:
        A `Transformed` coupling.

    Raises:
        TypeError: coupling is not a `Coupling`, or mean or spread is not callable.
        ValueError: as `Transformed`; when pairing, a spread is not positive.
    """
    check_function(mean, "mean", "of c")
    if spread is not None:
        check_function(spread, "spread", "of c")
    return Transformed(coupling, Residual(mean, spread))


@dataclass(frozen=True, repr=False)
class Residual(WithOptions):
    """(x1 - mean(c)) / spread(c), the values that `centred` pairs."""

    mean: OfCondition
    spread: OfCondition | None = None

    def __call__(self, x1: Tensor, c: Tensor) -> Tensor:
        """The residuals (B, d) of data (B, d)."""
        for name in ("mean", "spread"):
            check_draws_nothing(getattr(self, name), name, "a row gets another residual each time")
        mean = check_like(self.mean(*lent(c)), "mean(c)", x1)
        residual = x1 - mean.to(x1)
        if self.spread is None:
            return without_rounding(residual, x1, mean)
        spread = self.spread(*lent(c))
        check_like(spread, "spread(c)", x1[:, :1] if np.shape(spread)[1:] == (1,) else x1)
        if not (spread > 0).all():
            raise ValueError(f"spread must be positive, got {float(spread.min()):.3g}")
        return without_rounding(residual / spread.to(x1), x1 / spread.to(x1), mean, spread)


def without_rounding(values: Tensor, computed_from: Tensor, *also: Tensor) -> Tensor:
    """Values (n, d), where those of a column are equal that differ by rounding of larger numbers.

    Rounding depends on the condition, and where other values are equal it alone would choose pairs.
    Values that lie so densely that their neighbours differ by as little are left as they are: their
    rounding moves pairs to neighbours only. The coarsest type of all tensors counts.
    """
    eps = max(torch.finfo(x.dtype).eps for x in (values, *also))
    found = values.detach()
    found = found if found.dtype == torch.float64 else found.float()
    in_order, order = found.sort(dim=0)
    larger = torch.maximum(computed_from.detach().abs().to(found), found.abs())
    error = (ROUNDING * eps * larger).gather(0, order)
    apart = in_order.diff(dim=0) > torch.maximum(error[1:], error[:-1])
    place = torch.arange(1, len(values), device=values.device)[:, None]
    first = torch.cat([torch.zeros_like(order[:1]), torch.where(apart, place, 0)]).cummax(dim=0)[0]
    most, last = (x.scatter_reduce(0, first, x, "amax").gather(0, first) for x in (error, in_order))
    least = in_order.gather(0, first)
    equal = torch.where(last - least <= 2 * most, least, in_order)
    return torch.empty_like(found).scatter(0, order, equal).to(values)
