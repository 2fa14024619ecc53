"""The base class of all couplings (`Coupling`) and what a coupling returns (`Pairs`)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from torch import Generator, Tensor

from cotlearn import validation

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MANY_DIMENSIONS = 12  #: columns from which a matrix product computes distances faster
LOST_DIGITS = 1e-6  #: share of the largest |a|^2 + |b|^2 below which the product loses digits


@dataclass(frozen=True)
class Pairs:
    """Paired noise x0 and data x1, with the condition that the network is given.

    Attributes:
        x0: (B, d) noise.
        x1: (B, d) data.
        c: (B, k) conditions, or None.
        source_index: (B,) row of each x0 in the input batch.
        target_index: (B,) row of each x1 in the input batch.
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
        validation.check_shape(x0, "x0", shape)
        validation.check_shape(self.x1, "x1", shape)
        if c is not None and not (isinstance(c, Tensor) and c.ndim == 2 and len(c) == len(x0)):
            raise ValueError(f"c must have shape ({len(x0)}, columns), got {c!r}")

    def __len__(self) -> int:
        return len(self.x0)

    def map(self, change: Callable[[Tensor], Tensor]) -> Pairs:
        """Apply `change` to every tensor, for instance to slice it or to move it to a device."""
        given = (getattr(self, f.name) for f in fields(self))
        values: Any = (None if value is None else change(value) for value in given)
        return Pairs(*values)

    @staticmethod
    def cat(parts: Sequence[Pairs]) -> Pairs:
        """Concatenate several `Pairs` row by row."""
        if len(parts) == 1:
            return parts[0]
        columns = ([getattr(part, f.name) for part in parts] for f in fields(Pairs))
        values: Any = (None if column[0] is None else torch.cat(column) for column in columns)
        return Pairs(*values)


class Sampler(Protocol):
    """Data: an object whose `sample(n, generator=g)` returns (x1, c); c may be None."""

    def sample(self, n: int, generator: Generator | None = None) -> tuple[Tensor, Tensor | None]:
        """Draw x1 of shape (n, d) and c of shape (n, k)."""


class Source(Protocol):
    """Noise: a callable whose `source(n, generator=g)` returns x0 of shape (n, d)."""

    def __call__(self, n: int, generator: Generator | None = None) -> Tensor:
        """Draw n rows."""


class Match(NamedTuple):
    """The rows of source and target that a coupling pairs."""

    source_index: Index
    target_index: Index
    condition_index: Index | None = None  #: row of c that labels each pair; None: target_index
    x1: Tensor | None = None  #: data of the pairs; None: x1[target_index]
    weight: Tensor | None = None  #: weight of each row in the loss; None: equal weights


class WithOptions:
    """A dataclass whose repr gives functions by name, so that checkpoints can compare it."""

    def __repr__(self) -> str:
        own: Any = self
        values = {f.name: getattr(self, f.name) for f in fields(own) if f.repr}
        options = (f"{k}={getattr(v, '__qualname__', None) or repr(v)}" for k, v in values.items())
        return f"{type(self).__name__}({', '.join(options)})"


@dataclass(repr=False, eq=False)
class Coupling(WithOptions):
    """Pairs noise with data. A new coupling overrides `match`, and nothing else.

    Its options are the fields of a dataclass, `@dataclass(repr=False)`. A coupling that needs the
    whole data set sets `whole_data = True` and is given an epoch instead of a batch: see `prepare`
    and `epoch_rows`. A coupling that needs the model sets `uses_network = True` and overrides
    `observe`.
    """

    name = "coupling"
    uses_network = False
    uses_ot_batch = False  #: a larger ot_batch_size gives each row more candidates
    whole_data = False  #: needs the whole data set; ot_batch_size does not apply
    solves = True  #: pairing takes long enough to be worth a background thread
    needs_condition = False
    transformable = True  #: pairs rows of a batch by x1 and c alone (see `Transformed`)

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Choose which rows of x0 (B, d) and x1 (B, d) to pair; `__call__` has checked them."""
        raise NotImplementedError

    def __call__(
        self, x0: Tensor, x1: Tensor, c: Tensor | None = None, generator: Generator | None = None
    ) -> Pairs:
        """Pair a batch.

        Args:
            x0: (B, d) noise, floating point and finite; any device.
            x1: (B, d) data.
            c: (B, k) conditions of x1, or None if the coupling does not need them.
            generator: source of randomness; torch's global generator if None.

        Returns:
            `Pairs` of B rows, with the devices and dtypes of the inputs. Inputs are not changed.

        Raises:
            TypeError: an input is not a floating-point tensor, or c is None but needed.
            ValueError: shapes do not match, a batch is empty, or values are not finite.
        """
        validation.check_matrix(x0, "x0", hint=validation.IMAGES)
        validation.check_matrix(x1, "x1", columns=x0.shape[1], hint=validation.IMAGES)
        validation.check_same_rows(x1, "x1", x0, "x0")
        self._check_condition(c, x0, "x0")
        validation.check_generator(generator)
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
        generator: Generator | None = None,
        start: int = 0,
    ) -> Iterator[Pairs]:
        """Yield training batches without end.

        Batch number s depends only on the generator's seed and s, so that a stream resumed with
        `start` continues with the same batches. Where whole epochs are paired, an incomplete last
        batch is dropped, and epochs smaller than a batch are concatenated.

        Args:
            data: has `sample(n, generator=g) -> (x1, c)`; for a coupling with `whole_data` also
                `x1`, `c` and a length.
            batch_size: rows of each yielded `Pairs`.
            ot_batch_size: rows that are paired at once, a multiple of batch_size; batch_size if
                None. More rows help if the coupling has `uses_ot_batch`.
            source: draws the noise; standard normal if None.
            generator: only its initial seed counts; torch's global seed if None.
            start: number of the first batch.

        Raises:
            TypeError: the data have no `sample`, or are endless, but the coupling needs the whole
                data set.
            ValueError: a size is out of range, or ot_batch_size is given to a coupling with
                `whole_data`.
        """
        validation.check_count(batch_size, "batch_size")
        ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
        validation.check_count(ot_batch_size, "ot_batch_size", minimum=batch_size)
        if ot_batch_size % batch_size or (self.whole_data and ot_batch_size != batch_size):
            allowed = "equal to" if self.whole_data else "a multiple of"  # all the data are paired
            raise ValueError(
                f"ot_batch_size must be {allowed} batch_size {batch_size} for "
                f"{type(self).__name__}, got {ot_batch_size}"
            )
        validation.check_count(start, "start", minimum=0)
        validation.check_generator(generator)
        if source is not None:
            validation.check_function(source, "source", "(n, generator) -> x0")
        wanted = "an object with sample(n, generator), as Dataset(x1, c)"
        validation.check_has(data, "data", wanted, "x1" if hasattr(data, "x1") else "sample")
        seed = torch.initial_seed() if generator is None else generator.initial_seed()
        epoch = self.epoch_rows(data)
        self.prepare(data, source, generator_for(seed, 0, purpose=3))
        rows, solves = epoch or ot_batch_size, -(-batch_size // epoch) if epoch else 1
        number, first = divmod(start, solves * rows // batch_size)
        while True:
            generators = [generator_for(seed, number * solves + k) for k in range(solves)]
            pairs = Pairs.cat([self.solve(data, rows, source, rng) for rng in generators])
            if epoch:  # its pairs are ordered by cluster
                shuffle = generator_for(seed, number, purpose=2)
                pairs = pairs.map(itemgetter(torch.randperm(len(pairs), generator=shuffle)))
            for k in range(first, len(pairs) // batch_size):
                yield pairs.map(itemgetter(slice(k * batch_size, (k + 1) * batch_size)))
            number, first = number + 1, 0

    def prepare(self, data: Any, source: Source | None, generator: Generator) -> None:
        """Fit clusters or potentials to the data before the first batch of a stream."""

    def epoch_rows(self, data: Any) -> int:
        """Rows of an epoch if a whole epoch is paired at once; 0 if batches are."""
        return 0

    def draw(self, data: Any, n: int, generator: Generator) -> tuple[Tensor, Tensor | None]:
        """Draw the n rows (x1, c) that a stream pairs at once."""
        return data.sample(n, generator=generator)

    def solve(self, data: Any, n: int, source: Source | None, generator: Generator) -> Pairs:
        """Draw n rows of data and noise for a stream, and pair them."""
        x1, c = self.draw(data, n, generator)
        return self(draw_noise(x1, source, generator), x1, c, generator)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Average number of data rows that a noise row can choose from in this batch.

        This number limits how much a coupling can straighten paths. It is 1 if row i is paired with
        row i. If the cost includes the conditions, only rows count whose condition cost does not
        exceed the mean sample cost: 1 + (B - 1)/K rows for K balanced labels and a large weight.
        """
        return 1.0

    def observe(self, network: torch.nn.Module, step: int) -> None:
        """Take the current EMA network before `step`; most couplings ignore it."""

    def state_dict(self) -> dict[str, Tensor]:
        """Tensors needed to resume training; empty for most couplings."""
        return {}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned."""

    def _check_condition(self, c: Tensor | None, x: Tensor, name: str) -> None:
        """Raise TypeError or ValueError unless c are conditions of the rows of x."""
        if c is not None:
            validation.check_same_rows(validation.check_condition(c), "c", x, name)
        elif self.needs_condition:
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")

    def _check_finite(self, data: Any) -> None:
        """Raise TypeError unless the data have `x1`, `c` and a length."""
        if not all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            raise TypeError(
                f"{type(self).__name__} needs finite data with x1, c and len, got endless data: "
                "draw a Dataset from them, or give n_samples to StratifiedOT"
            )


class Batches(Coupling):
    """A coupling that yields existing batches of `Pairs`."""

    solves = False

    def __init__(self, batches: Iterator[Pairs]) -> None:
        self._batches = batches

    def solve(self, data: Any, n: int, source: Source | None, generator: Generator) -> Pairs:
        """The next batch."""
        return next(self._batches)


class Last:
    """A cache of a function's last value, reused while its tensors are the same objects."""

    def __init__(self) -> None:
        self.tensors: tuple[Tensor, ...] = ()
        self.value: Any = None

    def __call__(self, function: Callable[..., Any], *tensors: Tensor) -> Any:
        """The function's value for these tensors, from the cache if they are the last ones."""
        same = len(tensors) == len(self.tensors)
        if not (same and all(a is b for a, b in zip(tensors, self.tensors, strict=True))):
            self.tensors, self.value = tensors, function(*tensors)
        return self.value


def check_like(value: Any, name: str, x: Tensor) -> Tensor:
    """Return a user function's `value` if it is finite and has the shape of x (B, d)."""
    return validation.check_matrix(validation.check_shape(value, name, tuple(x.shape)), name)


def draw_noise(x1: Tensor, source: Source | None, generator: Generator) -> Tensor:
    """Draw noise with the shape of x1 (n, d), standard normal unless a source is given."""
    if source is None:
        return torch.randn(x1.shape, dtype=x1.dtype, generator=generator)
    drawn = source(len(x1), generator=generator)
    return validation.check_shape(drawn, "source(n)", tuple(x1.shape))


def generator_for(seed: int, number: int, purpose: int = 0) -> Generator:
    """A generator seeded by (seed, number, purpose) only, the same on every machine."""
    sequence = np.random.SeedSequence([seed % 2**64, number, purpose])
    return torch.Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]) >> 1)


def squared_distances(first: Tensor, second: Tensor) -> Array:
    """|a_i - b_j|^2 for all rows, float64, shape (len(first), len(second)).

    From 12 dimensions on, one matrix product of (-2a, |a|^2, 1) and (b, 1, |b|^2) is faster.
    Distances so small that the product loses digits are computed again directly, so that equal
    rows have distance 0.
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
    return cdist(a, b, "sqeuclidean")


def near_rows(weight: float, condition_cost: Array, sample_cost: Array) -> float:
    """Mean number of conditions per row whose weighted cost is at most the mean sample cost."""
    return float((weight * condition_cost <= sample_cost.mean()).sum(axis=1).mean())


def to_numpy(value: Tensor) -> Array:
    """A tensor as a float64 array on the CPU; shares memory if it is one already."""
    return value.detach().to("cpu", torch.float64).numpy()


def _numpy_rng(generator: Generator | None) -> np.random.Generator:
    device = "cpu" if generator is None else generator.device
    seed = torch.randint(2**62, (1,), generator=generator, device=device)
    return np.random.default_rng(int(seed))
