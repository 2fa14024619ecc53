"""What every coupling is (`Coupling`), and what it returns (`Pairs`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from torch import Tensor

from cotlearn.validation import check_condition, check_count, check_matrix, check_same_rows

MANY_DIMENSIONS = 12  #: from here on a matrix product is the faster way to distances
LOST_DIGITS = 1e-6  #: share of the largest |a|^2 + |b|^2 below which a product would lose digits


@dataclass(frozen=True)
class Pairs:
    """Noise x0 and data x1 that train together, with the condition the network is given.

    Attributes:
        x0: (B, d) noise.
        x1: (B, d) data.
        c: (B, k) conditions, or None.
        source_index: (B,) row of each x0 in the batch that went in.
        target_index: (B,) row of each x1 in the batch that went in.
        weight: (B,) weight of each row in the loss, or None for equal weights.
    """

    x0: Tensor
    x1: Tensor
    c: Tensor | None
    source_index: Tensor
    target_index: Tensor
    weight: Tensor | None = None

    def __post_init__(self) -> None:
        for name in ("x0", "x1"):
            value = getattr(self, name)
            if not isinstance(value, Tensor) or not value.is_floating_point():
                got = value.dtype if isinstance(value, Tensor) else type(value).__name__
                raise TypeError(f"{name} must be a floating-point tensor, got {got}")
        if self.x0.ndim != 2 or self.x0.shape != self.x1.shape or not self.x0.numel():
            raise ValueError(
                "x0 and x1 must have one shape (rows, columns) and not be empty, got "
                f"{tuple(self.x0.shape)} and {tuple(self.x1.shape)}"
            )
        if self.c is not None and (not isinstance(self.c, Tensor) or self.c.ndim != 2):
            shape = getattr(self.c, "shape", type(self.c).__name__)
            raise ValueError(f"c must be a tensor of shape (rows, columns), got {shape}")
        if self.c is not None and len(self.c) != len(self.x0):
            raise ValueError(f"c has {len(self.c)} rows, x0 has {len(self.x0)}")

    def __len__(self) -> int:
        return len(self.x0)

    def map(self, change: Callable[[Tensor], Tensor]) -> Pairs:
        """The pairs with `change` applied to every tensor: a slice, another device."""
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        return replace(self, **{n: change(v) for n, v in given.items() if v is not None})


class Sampler(Protocol):
    """Data: anything whose `sample(n, generator=g)` returns (x1, c), c possibly None."""

    def sample(
        self, n: int, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor | None]:
        """Draw x1 of shape (n, d) and c of shape (n, k)."""
        ...


class Source(Protocol):
    """Noise: anything that called as `source(n, generator=g)` returns x0 of shape (n, d)."""

    def __call__(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw n rows."""
        ...


class Match(NamedTuple):
    """The rows of source and target that a coupling puts together, and what is not x1[target]."""

    source_index: NDArray[np.int64]
    target_index: NDArray[np.int64]
    c: Tensor | None = None  #: labels, where they are not c[target_index]
    x1: Tensor | None = None  #: data, where it is not x1[target_index]
    weight: Tensor | None = None  #: of each row in the loss


class StreamOptions(NamedTuple):
    """What `Coupling.stream` was asked for, checked; `seed` decides all its randomness."""

    batch_size: int
    ot_batch_size: int
    source: Source | None
    seed: int
    start: int  #: number of the first batch


class Coupling:
    """Decides which noise meets which data. A new coupling overrides `match`, and nothing else.

    Couplings that look at the whole data set set `whole_data` and override `batches`; couplings
    that look at the model set `uses_network` and override `observe`.
    """

    name: str = "coupling"
    uses_network: bool = False
    uses_ot_batch: bool = False  #: more rows paired at once give each a better choice
    whole_data: bool = False  #: all the data are looked at: no ot_batch_size applies
    solves: bool = True  #: pairing takes long enough to be done in the background
    needs_condition: bool = False

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Which rows of x0 and x1 meet; arguments are checked already."""
        raise NotImplementedError

    def __call__(
        self,
        x0: Tensor,
        x1: Tensor,
        c: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Pairs:
        """Pair a batch.

        Args:
            x0: (B, d) noise, floating point and finite; any device.
            x1: (B, d) data.
            c: (B, k) conditions of x1, or None where the coupling does not need one.
            generator: randomness; the default is torch's global one.

        Returns:
            `Pairs` of B rows with the devices and dtypes of the inputs, which are not changed.

        Raises:
            TypeError: an input is not a floating-point tensor, or c is needed and None.
            ValueError: shapes do not match, a batch is empty, or values are not finite.
        """
        self.check_batch(x0, x1, c)
        with torch.no_grad():
            match = self.match(x0, x1, c, _numpy_rng(generator))
        source = torch.from_numpy(match.source_index).to(x0.device)
        target = torch.from_numpy(match.target_index).to(x0.device)
        paired = x1[target.to(x1.device)] if match.x1 is None else match.x1
        label = match.c
        if label is None and c is not None:
            label = c[target.to(c.device)]
        return Pairs(x0[source], paired, label, source, target, match.weight)

    def check_batch(self, x0: Tensor, x1: Tensor, c: Tensor | None) -> None:
        """Raise TypeError or ValueError unless this is a batch, as for a call."""
        check_matrix(x0, "x0")
        check_matrix(x1, "x1", columns=x0.shape[1])
        check_same_rows(x1, "x1", x0, "x0")
        if c is not None:
            check_same_rows(check_condition(c), "c", x0, "x0")
        elif self.needs_condition:
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")

    def stream(
        self,
        data: Sampler,
        *,
        batch_size: int,
        ot_batch_size: int | None = None,
        source: Source | None = None,
        generator: torch.Generator | None = None,
        start: int = 0,
    ) -> Iterator[Pairs]:
        """Yield training batches for ever.

        Batch number s is a function of the generator's seed and s alone, so that a stream resumed
        with `start` goes on with the same numbers.

        Args:
            data: has `sample(n, generator=g) -> (x1, c)`; see the coupling where it needs more.
            batch_size: rows of each yielded `Pairs`.
            ot_batch_size: rows that are paired at once; a multiple of batch_size (the default).
                More rows help where the coupling has `uses_ot_batch`.
            source: draws the noise; standard normal if None.
            generator: its initial seed decides everything; torch's global seed if None.
            start: number of the first batch.

        Raises:
            ValueError: a size out of range, or an ot_batch_size where all the data are paired.
        """
        check_count(batch_size, "batch_size")
        ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
        check_count(ot_batch_size, "ot_batch_size", minimum=batch_size)
        if self.whole_data and ot_batch_size != batch_size:
            raise ValueError(
                f"ot_batch_size does not apply to {type(self).__name__}, which looks at all the "
                f"data: it must be None or batch_size {batch_size}, got {ot_batch_size}"
            )
        if ot_batch_size % batch_size:
            raise ValueError(
                f"ot_batch_size must be a multiple of batch_size {batch_size}, got {ot_batch_size}"
            )
        check_count(start, "start", minimum=0)
        seed = torch.initial_seed() if generator is None else generator.initial_seed()
        yield from self.batches(data, StreamOptions(batch_size, ot_batch_size, source, seed, start))

    def batches(self, data: Sampler, options: StreamOptions) -> Iterator[Pairs]:
        """What `stream` yields, its options checked: draw an OT batch, pair it, cut it up."""
        per_solve = options.ot_batch_size // options.batch_size
        number, part = divmod(options.start, per_solve)
        while True:
            rng = generator_for(options.seed, number)
            x1, c = data.sample(options.ot_batch_size, generator=rng)
            x0 = draw_noise(x1, options.source, rng)
            pairs = self(x0, x1, c, generator=rng)
            for k in range(part, per_solve):
                rows = slice(k * options.batch_size, (k + 1) * options.batch_size)
                yield pairs.map(lambda value, rows=rows: value[rows])  # type: ignore[misc]
            number, part = number + 1, 0

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """How many rows of the data a noise row can choose from, on average, in such a batch.

        The straightening of any coupling is limited by this number; it is 1 where rows pair with
        themselves. Where conditions have a price, rows count whose condition costs no more than
        an average sample distance: 1 + (B - 1)/K for K balanced labels and a large weight.
        """
        return 1.0

    def epoch_rows(self, data: Sampler) -> int:
        """Rows of an epoch, where a whole epoch is paired at once; 0 where batches are."""
        return 0

    def observe(self, network: torch.nn.Module, step: int) -> None:
        """See the current (EMA) network before `step`; most couplings do not look."""

    def state_dict(self) -> dict[str, Tensor]:
        """Tensors that a resumed training needs; most couplings have none."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""

    def __repr__(self) -> str:
        options = ", ".join(
            f"{name}={spelled(value)}"
            for name, value in vars(self).items()
            if not name.startswith("_")
        )
        return f"{type(self).__name__}({options})"


def spelled(value: object) -> str:
    """`repr`, but a function by its name: a checkpoint compares these texts between processes."""
    return getattr(value, "__qualname__", None) or repr(value)


def draw_noise(x1: Tensor, source: Source | None, generator: torch.Generator) -> Tensor:
    """Noise of the shape of x1, standard normal unless a source is given."""
    if source is None:
        return torch.randn(x1.shape, dtype=x1.dtype, generator=generator)
    x0 = source(len(x1), generator=generator)
    if not isinstance(x0, Tensor) or x0.shape != x1.shape:
        got = tuple(x0.shape) if isinstance(x0, Tensor) else type(x0).__name__
        raise ValueError(f"source must return a tensor of shape {tuple(x1.shape)}, got {got}")
    return x0


def generator_for(seed: int, number: int, purpose: int = 0) -> torch.Generator:
    """A generator that depends on (seed, number, purpose) alone, on every machine the same."""
    sequence = np.random.SeedSequence([seed % 2**64, number, purpose])
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]) >> 1)


def squared_distances(first: Tensor, second: Tensor) -> NDArray[np.float64]:
    """|a_i - b_j|^2 for all rows, float64, shape (len(first), len(second))."""
    return array_distances(to_numpy(first), to_numpy(second))


def array_distances(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """`squared_distances` of arrays.

    In many dimensions by one matrix product, of (-2a, |a|^2, 1) and (b, 1, |b|^2), and again
    without it where rows are so near each other that the product would lose digits; equal rows
    have distance 0 either way.
    """
    distances: NDArray[np.float64]
    if a.shape[1] >= MANY_DIMENSIONS:
        centre = b.mean(axis=0)
        a, b = a - centre, b - centre
        norms_a, norms_b = (a * a).sum(axis=1), (b * b).sum(axis=1)
        left = np.column_stack([-2 * a, norms_a, np.ones(len(a))])
        distances = left @ np.column_stack([b, np.ones(len(b)), norms_b]).T
        near = LOST_DIGITS * (norms_a.max() + norms_b.max())
        if distances.min() >= near:
            return distances
        rows, columns = np.nonzero(distances < near)
        if len(rows) < distances.size // 100:
            distances[rows, columns] = ((a[rows] - b[columns]) ** 2).sum(axis=1)
            return distances
    distances = cdist(a, b, "sqeuclidean")
    return distances


def to_numpy(value: Tensor) -> NDArray[np.float64]:
    """float64 on the CPU; shares memory with a value that is so already."""
    array: NDArray[np.float64] = value.detach().to("cpu", torch.float64).numpy()
    return array


def _numpy_rng(generator: torch.Generator | None) -> np.random.Generator:
    device = "cpu" if generator is None else generator.device
    seed = torch.randint(2**62, (1,), generator=generator, device=device)
    return np.random.default_rng(int(seed))
