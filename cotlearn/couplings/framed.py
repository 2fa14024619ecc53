"""Pair in a frame that the condition gives: seen from the object, from the goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Pairs, spelled
from cotlearn.couplings.wrapped import Wrapped

Turn = Callable[[Tensor, Tensor], Tensor]


class Framed(Wrapped):
    """Any coupling, which sees noise and data as they look in the frame of their condition.

    Where the condition holds a direction, say of an object that is to be pushed, data follow it:
    what is alike from the object points every way in the world. In the world a coupling hands that
    difference to the noise, which then tells the condition. In the frame there is less of it, or
    none: if the data as seen there do not depend on c, even naive OT leaves the prior as it is.

    Noise is drawn in the frame, paired there, and turned back with its data. For x0 given c to stay
    the prior, `into` must be orthogonal for every c (a rotation, a reflection, a permutation of
    columns), and the noise standard normal or otherwise blind to it.

    Args:
        coupling: that pairs in the frame, see `Wrapped`.
        into: (x, c) -> x as seen in the frame, both (B, d).
        out: (x, c) -> x, its inverse.

    Raises:
        TypeError: not a coupling, or no functions; in use: data without a condition.
        ValueError: a coupling that cannot be framed; in use: a function that changes the shape, or
            lengths.
    """

    def __init__(self, coupling: Coupling, into: Turn, out: Turn) -> None:
        super().__init__(coupling)
        for name, function in (("into", into), ("out", out)):
            if not callable(function):
                raise TypeError(f"{name} must be a function (x, c) -> x, got {function!r}")
        self.into, self.out = into, out

    def _seen(self, x1: Tensor, c: Tensor) -> Tensor:
        """The data in the frame."""
        return _turned(self.into, "into", x1, c)

    def _drawn(self, x0: Tensor, c: Tensor) -> Tensor:
        """The noise in the frame."""
        return _turned(self.into, "into", x0, c)

    def _restored(self, pairs: Pairs) -> Pairs:
        """Noise and data turned back."""
        assert pairs.c is not None
        x0, x1 = (_turned(self.out, "out", x, pairs.c) for x in (pairs.x0, pairs.x1))
        return replace(pairs, x0=x0, x1=x1)

    def __repr__(self) -> str:
        return f"Framed({self.coupling!r}, {spelled(self.into)}, {spelled(self.out)})"


def _turned(function: Turn, name: str, x: Tensor, c: Tensor) -> Tensor:
    """What the function makes of x; the same lengths, or it is no turn."""
    with torch.no_grad():
        seen = function(x, c)
    if not isinstance(seen, Tensor) or seen.shape != x.shape or not torch.isfinite(seen).all():
        got = tuple(seen.shape) if isinstance(seen, Tensor) else type(seen).__name__
        raise ValueError(f"{name} must return finite values of shape {tuple(x.shape)}, got {got}")
    before, after = x.double().norm(dim=1), seen.double().norm(dim=1)
    worst = float((after - before).abs().max())
    if worst > 1e-3 * float(before.max()):
        raise ValueError(
            f"{name} must keep the length of every row, as rotations do, so that noise stays the "
            f"prior; a length changed by {worst:.3g}"
        )
    return seen
