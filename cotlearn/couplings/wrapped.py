"""What couplings have in common that let another one pair, and change what it sees."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor

from cotlearn.couplings.base import Coupling, Pairs, Sampler, StreamOptions
from cotlearn.datasets import Dataset
from cotlearn.validation import check_condition


class Wrapped(Coupling):
    """A coupling inside, which pairs the data as they look from their condition.

    A new one overrides `_seen` and `_restored`, and `_drawn` if noise looks different, too.

    Args:
        coupling: that pairs; `name`, flags and state of this one are its own. Not one that asks
            the network, nor one that keeps the source's label.

    Raises:
        TypeError: not a coupling; in use: data without a condition.
        ValueError: a coupling that cannot be wrapped.
    """

    needs_condition = True

    def __init__(self, coupling: Coupling) -> None:
        if not isinstance(coupling, Coupling):
            raise TypeError(f"coupling must be a Coupling, got {coupling!r}")
        if coupling.uses_network or getattr(coupling, "label", "target") != "target":
            raise ValueError(
                "coupling must neither ask the network, which knows x as it is, nor keep the "
                f"source's label, which is not the one x1 is seen from, got {coupling!r}"
            )
        self.coupling = coupling
        self.name = coupling.name
        self.uses_ot_batch = coupling.uses_ot_batch
        self.whole_data = coupling.whole_data
        self.solves = coupling.solves

    def _seen(self, x1: Tensor, c: Tensor) -> Tensor:
        """The data (B, d) as the coupling inside sees them."""
        raise NotImplementedError

    def _drawn(self, x0: Tensor, c: Tensor) -> Tensor:
        """The noise (B, d) of a stream as the coupling inside had it."""
        return x0

    def _restored(self, pairs: Pairs) -> Pairs:
        """Pairs of data as they are, of pairs of data as they were seen."""
        raise NotImplementedError

    def __call__(
        self,
        x0: Tensor,
        x1: Tensor,
        c: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Pairs:
        """Pair a batch; x0 (B, d) is noise as the coupling inside sees it, x1 (B, d) plain data."""
        self.check_batch(x0, x1, c)
        assert c is not None
        return self._restored(self.coupling(x0, self._seen(x1, c), c, generator))

    def batches(self, data: Sampler, options: StreamOptions) -> Iterator[Pairs]:
        """Those of the coupling inside for the data as it sees them, restored."""
        seen: Sampler = _Seen(data, self)
        if all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            whole: Any = data
            seen = Dataset(self._seen(whole.x1, check_condition(whole.c)), whole.c)
        return (self._restored(pairs) for pairs in self.coupling.batches(seen, options))

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Those of the coupling inside, for noise x0 as `stream` gives it."""
        self.check_batch(x0, x1, c)
        assert c is not None
        return self.coupling.candidates(self._drawn(x0, c), self._seen(x1, c), c)

    def epoch_rows(self, data: Sampler) -> int:
        """Those of the coupling inside."""
        return self.coupling.epoch_rows(data)

    def state_dict(self) -> dict[str, Tensor]:
        """Of the coupling inside."""
        return self.coupling.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Give the coupling inside back its own."""
        self.coupling.load_state_dict(state)


class _Seen:
    """Endless data, as the coupling inside sees them."""

    def __init__(self, data: Sampler, wrapped: Wrapped) -> None:
        self.data, self.wrapped = data, wrapped

    def sample(
        self, n: int, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """(x1, c), x1 as it is seen."""
        x1, c = self.data.sample(n, generator=generator)
        return self.wrapped._seen(x1, check_condition(c)), c
