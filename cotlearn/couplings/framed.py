"""Pair in a frame that the condition gives: seen from the object, from the goal."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Pairs, Sampler, StreamOptions, spelled
from cotlearn.datasets import Dataset
from cotlearn.validation import check_condition

Turn = Callable[[Tensor, Tensor], Tensor]


class Framed(Coupling):
    """Any coupling, which sees noise and data as they look in the frame of their condition.

    Where the condition holds a direction, say of an object that is to be pushed, data follow it:
    what is alike from the object points every way in the world. In the world a coupling hands that
    difference to the noise, which then tells the condition. In the frame there is less of it, or
    none: if the data as seen there do not depend on c, even naive OT leaves the prior as it is.

    Noise is drawn in the frame, paired there, and turned back with its data. For x0 given c to stay
    the prior, `into` must be orthogonal for every c (a rotation, a reflection, a permutation of
    columns), and the noise standard normal or otherwise blind to it.

    Args:
        coupling: that pairs in the frame; `name`, flags and state of this one are its own. Not one
            that asks the network, nor one that keeps the source's label.
        into: (x, c) -> x as seen in the frame, both (B, d).
        out: (x, c) -> x, its inverse.

    Raises:
        TypeError: not a coupling, or no functions; in use: data without a condition.
        ValueError: a coupling that cannot be framed; in use: a function that changes the shape, or
            lengths.
    """

    needs_condition = True

    def __init__(self, coupling: Coupling, into: Turn, out: Turn) -> None:
        if not isinstance(coupling, Coupling):
            raise TypeError(f"coupling must be a Coupling, got {coupling!r}")
        if coupling.uses_network or getattr(coupling, "label", "target") != "target":
            raise ValueError(
                "coupling must neither ask the network, which knows x as it is, nor keep the "
                f"source's label, which is not the frame of x1, got {coupling!r}"
            )
        for name, function in (("into", into), ("out", out)):
            if not callable(function):
                raise TypeError(f"{name} must be a function (x, c) -> x, got {function!r}")
        self.coupling, self.into, self.out = coupling, into, out
        self.name = coupling.name
        self.uses_ot_batch = coupling.uses_ot_batch
        self.whole_data = coupling.whole_data
        self.solves = coupling.solves

    def __call__(
        self,
        x0: Tensor,
        x1: Tensor,
        c: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Pairs:
        """Pair a batch; x0 (B, d) is noise as drawn in the frame, x1 (B, d) data as they are."""
        self.check_batch(x0, x1, c)
        assert c is not None
        return self._back(self.coupling(x0, _turned(self.into, "into", x1, c), c, generator))

    def batches(self, data: Sampler, options: StreamOptions) -> Iterator[Pairs]:
        """Those of the coupling for data as seen in the frame, turned back."""
        seen: Sampler = _Seen(data, self.into)
        if all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            whole: Any = data
            check_condition(whole.c)
            seen = Dataset(_turned(self.into, "into", whole.x1, whole.c), whole.c)
        return (self._back(pairs) for pairs in self.coupling.batches(seen, options))

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Those of the coupling, in the frame, for noise x0 as `stream` gives it."""
        self.check_batch(x0, x1, c)
        assert c is not None
        seen = [_turned(self.into, "into", x, c) for x in (x0, x1)]
        return self.coupling.candidates(seen[0], seen[1], c)

    def epoch_rows(self, data: Sampler) -> int:
        """Those of the coupling."""
        return self.coupling.epoch_rows(data)

    def state_dict(self) -> dict[str, Tensor]:
        """Of the coupling."""
        return self.coupling.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Give the coupling back its own."""
        self.coupling.load_state_dict(state)

    def __repr__(self) -> str:
        return f"Framed({self.coupling!r}, {spelled(self.into)}, {spelled(self.out)})"

    def _back(self, pairs: Pairs) -> Pairs:
        assert pairs.c is not None
        x0, x1 = (_turned(self.out, "out", x, pairs.c) for x in (pairs.x0, pairs.x1))
        return replace(pairs, x0=x0, x1=x1)


class _Seen:
    """Endless data, as seen in the frame."""

    def __init__(self, data: Sampler, into: Turn) -> None:
        self.data, self.into = data, into

    def sample(
        self, n: int, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """(x1, c), x1 in the frame."""
        x1, c = self.data.sample(n, generator=generator)
        return _turned(self.into, "into", x1, check_condition(c)), c


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
