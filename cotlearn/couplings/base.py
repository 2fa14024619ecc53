"""What every coupling is (`Coupling`), and what it returns (`Pairs`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from torch import Tensor

from cotlearn.validation import (
    check_condition,
    check_count,
    check_matrix,
    check_same_rows,
    check_shape,
)

Array = NDArray[np.float64]
Index = NDArray[np.int64]

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
        x0, c, shape = self.x0, self.c, np.shape(self.x0)
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"x0 must have shape (rows, columns) and not be empty, got {shape}")
        check_shape(x0, "x0", shape)
        check_shape(self.x1, "x1", shape)
        if c is not None and not (isinstance(c, Tensor) and c.ndim == 2 and len(c) == len(x0)):
            raise ValueError(f"c must have shape ({len(x0)}, columns), got {c!r}")

    def __len__(self) -> int:
        return len(self.x0)

    def map(self, change: Callable[[Tensor], Tensor]) -> Pairs:
        """The pairs with `change` applied to every tensor: a slice, another device."""
        given = (getattr(self, f.name) for f in fields(self))
        values: Any = (None if value is None else change(value) for value in given)
        return Pairs(*values)

    @staticmethod
    def cat(parts: Sequence[Pairs]) -> Pairs:
        """Several pairs as one."""
        if len(parts) == 1:
            return parts[0]
        columns = ([getattr(part, f.name) for part in parts] for f in fields(Pairs))
        values: Any = (None if column[0] is None else torch.cat(column) for column in columns)
        return Pairs(*values)


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
    """The rows of source and target that a coupling puts together."""

    source_index: Index
    target_index: Index
    condition_index: Index | None = None  #: rows of c that are the labels; target_index if None
    x1: Tensor | None = None  #: data, where it is not x1[target_index]
    weight: Tensor | None = None  #: of each row in the loss


class WithOptions:
    """A dataclass whose repr names functions: a checkpoint compares it between processes."""

    def __repr__(self) -> str:
        own: Any = self
        values = {f.name: getattr(self, f.name) for f in fields(own) if f.repr}
        options = (f"{k}={getattr(v, '__qualname__', None) or repr(v)}" for k, v in values.items())
        return f"{type(self).__name__}({', '.join(options)})"


@dataclass(repr=False, eq=False)
class Coupling(WithOptions):
    """Decides which noise meets which data. A new coupling overrides `match`, and nothing else.

    Its options are the fields of a dataclass, `@dataclass(repr=False)`. One that looks at all the
    data sets `whole_data` and gets an epoch in the place of a batch: see `prepare`, `epoch_rows`.
    One that looks at the model sets `uses_network` and overrides `observe`.
    """

    name = "coupling"
    uses_network = False
    uses_ot_batch = False  #: more rows paired at once give each a better choice
    whole_data = False  #: all the data are looked at: no ot_batch_size applies
    solves = True  #: pairing takes long enough to be done in the background
    needs_condition = False
    transformable = True  #: pairs rows of a batch by their x1 and c alone (see `Transformed`)

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
        check_matrix(x0, "x0")
        check_matrix(x1, "x1", columns=x0.shape[1])
        check_same_rows(x1, "x1", x0, "x0")
        self._check_condition(c, x0, "x0")
        with torch.no_grad():
            match = self.match(x0, x1, c, _numpy_rng(generator))
        source = torch.from_numpy(match.source_index).to(x0.device)
        target = torch.from_numpy(match.target_index).to(x0.device)
        paired = x1[target.to(x1.device)] if match.x1 is None else match.x1
        if c is not None:
            label = match.condition_index
            c = c[(target if label is None else torch.from_numpy(label)).to(c.device)]
        return Pairs(x0[source], paired, c, source, target, match.weight)

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
        with `start` goes on with the same numbers. Where whole epochs are paired, an incomplete
        last batch is left out, and epochs of fewer rows than a batch are put together.

        Args:
            data: has `sample(n, generator=g) -> (x1, c)`; for couplings of `whole_data` also `x1`,
                `c` and a length.
            batch_size: rows of each yielded `Pairs`.
            ot_batch_size: rows that are paired at once; a multiple of batch_size (the default).
                More rows help where the coupling has `uses_ot_batch`.
            source: draws the noise; standard normal if None.
            generator: its initial seed decides everything; torch's global seed if None.
            start: number of the first batch.

        Raises:
            TypeError: the data are endless, and the coupling must see all of them.
            ValueError: a size out of range, or an ot_batch_size where all the data are paired.
        """
        check_count(batch_size, "batch_size")
        ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
        check_count(ot_batch_size, "ot_batch_size", minimum=batch_size)
        if ot_batch_size % batch_size or (self.whole_data and ot_batch_size != batch_size):
            allowed = "equal to" if self.whole_data else "a multiple of"  # all the data are paired
            raise ValueError(
                f"ot_batch_size must be {allowed} batch_size {batch_size} for "
                f"{type(self).__name__}, got {ot_batch_size}"
            )
        check_count(start, "start", minimum=0)
        seed = torch.initial_seed() if generator is None else generator.initial_seed()
        epoch = self.epoch_rows(data)
        self.prepare(data, source, generator_for(seed, 0, purpose=3))
        rows, solves = epoch or ot_batch_size, -(-batch_size // epoch) if epoch else 1
        number, first = divmod(start, solves * rows // batch_size)
        while True:
            generators = [generator_for(seed, number * solves + k) for k in range(solves)]
            pairs = Pairs.cat([self.solve(data, rows, source, rng) for rng in generators])
            if epoch:  # it is paired cluster by cluster
                shuffle = generator_for(seed, number, purpose=2)
                pairs = pairs.map(itemgetter(torch.randperm(len(pairs), generator=shuffle)))
            for k in range(first, len(pairs) // batch_size):
                yield pairs.map(itemgetter(slice(k * batch_size, (k + 1) * batch_size)))
            number, first = number + 1, 0

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """See the data of a stream before its first batch, to fit clusters or potentials."""

    def epoch_rows(self, data: Any) -> int:
        """Rows of an epoch, where a whole epoch is paired at once; 0 where batches are."""
        return 0

    def draw(self, data: Any, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """The n rows (x1, c) of a stream that are paired at once."""
        x1, c = data.sample(n, generator=generator)
        return x1, c

    def solve(self, data: Any, n: int, source: Source | None, generator: torch.Generator) -> Pairs:
        """Draw n rows of a stream, and noise, and pair them."""
        x1, c = self.draw(data, n, generator)
        return self(draw_noise(x1, source, generator), x1, c, generator)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """How many rows of the data a noise row can choose from, on average, in such a batch.

        The straightening of any coupling is limited by this number; it is 1 where rows pair with
        themselves. Where conditions have a price, rows count whose condition costs no more than
        an average sample distance: 1 + (B - 1)/K for K balanced labels and a large weight.
        """
        return 1.0

    def observe(self, network: torch.nn.Module, step: int) -> None:
        """See the current (EMA) network before `step`; most couplings do not look."""

    def state_dict(self) -> dict[str, Tensor]:
        """Tensors that a resumed training needs; most couplings have none."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""

    def _check_condition(self, c: Tensor | None, x: Tensor, name: str) -> None:
        """Raise TypeError or ValueError unless c are conditions of the rows of x."""
        if c is not None:
            check_same_rows(check_condition(c), "c", x, name)
        elif self.needs_condition:
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")

    def _check_finite(self, data: Any) -> None:
        """Raise TypeError unless the data have `x1`, `c` and a length."""
        if not all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            raise TypeError(
                f"{type(self).__name__} looks at all the data, and these are endless (no x1, c and "
                "len): give a Dataset of rows drawn from them, or to StratifiedOT n_samples="
            )


class Batches(Coupling):
    """Pairs that are made already, batch by batch."""

    solves = False

    def __init__(self, batches: Iterator[Pairs]) -> None:
        self._batches = batches

    def solve(self, data: Any, n: int, source: Source | None, generator: torch.Generator) -> Pairs:
        """The next batch."""
        return next(self._batches)


class Last:
    """The last value of a function of tensors, kept for the same tensors: epoch after epoch."""

    def __init__(self) -> None:
        self.tensors: tuple[Tensor, ...] = ()
        self.value: Any = None

    def __call__(self, function: Callable[..., Any], *tensors: Tensor) -> Any:
        """The function's value for the tensors."""
        same = len(tensors) == len(self.tensors)
        if not (same and all(a is b for a, b in zip(tensors, self.tensors, strict=True))):
            self.tensors, self.value = tensors, function(*tensors)
        return self.value


def check_like(value: Any, name: str, x: Tensor) -> Tensor:
    """Return what a user's function gave if it is finite and has the shape of x (B, d)."""
    return check_matrix(check_shape(value, name, tuple(x.shape)), name)


def draw_noise(x1: Tensor, source: Source | None, generator: torch.Generator) -> Tensor:
    """Noise of the shape of x1, standard normal unless a source is given."""
    if source is None:
        return torch.randn(x1.shape, dtype=x1.dtype, generator=generator)
    return check_shape(source(len(x1), generator=generator), "source(n)", tuple(x1.shape))


def generator_for(seed: int, number: int, purpose: int = 0) -> torch.Generator:
    """A generator that depends on (seed, number, purpose) alone, on every machine the same."""
    sequence = np.random.SeedSequence([seed % 2**64, number, purpose])
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]) >> 1)


def squared_distances(first: Tensor, second: Tensor) -> Array:
    """|a_i - b_j|^2 for all rows, float64, shape (len(first), len(second)).

    In many dimensions by one matrix product, of (-2a, |a|^2, 1) and (b, 1, |b|^2), and again
    without it where rows are so near each other that the product would lose digits; equal rows
    have distance 0 either way.
    """
    a, b = to_numpy(first), to_numpy(second)
    if a.shape[1] >= MANY_DIMENSIONS:
        centre = b.mean(axis=0)
        a, b = a - centre, b - centre
        norms_a, norms_b = (a * a).sum(axis=1), (b * b).sum(axis=1)
        left = np.column_stack([-2 * a, norms_a, np.ones(len(a))])
        distances: Array = left @ np.column_stack([b, np.ones(len(b)), norms_b]).T
        near = LOST_DIGITS * (norms_a.max() + norms_b.max())
        if distances.min() >= near:
            return distances
        rows, columns = np.nonzero(distances < near)
        if len(rows) < distances.size // 100:
            distances[rows, columns] = ((a[rows] - b[columns]) ** 2).sum(axis=1)
            return distances
    nearby: Array = cdist(a, b, "sqeuclidean")
    return nearby


def near_rows(weight: float, condition_cost: Array, sample_cost: Array) -> float:
    """How many conditions, on average, cost no more than an average sample distance."""
    return float((weight * condition_cost <= sample_cost.mean()).sum(axis=1).mean())


def to_numpy(value: Tensor) -> Array:
    """float64 on the CPU; shares memory with a value that is so already."""
    array: Array = value.detach().to("cpu", torch.float64).numpy()
    return array


def _numpy_rng(generator: torch.Generator | None) -> np.random.Generator:
    device = "cpu" if generator is None else generator.device
    seed = torch.randint(2**62, (1,), generator=generator, device=device)
    return np.random.default_rng(int(seed))
