"""The base class of all couplings (`Coupling`) and what a coupling returns (`Pairs`)."""

from __future__ import annotations

import hashlib
import itertools
import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, fields
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Generator, Tensor
from torch.utils.data import IterableDataset, get_worker_info

from cotlearn import validation
from cotlearn.datasets import Dataset
from cotlearn.randomness import Purpose, generator_for

Array = NDArray[np.float64]
Index = NDArray[np.int64]

#: The generator by which a stream pairs: it made that for one batch, and other workers have others.
_OF_A_STREAM: ContextVar[Generator | None] = ContextVar("_OF_A_STREAM", default=None)


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
        group: (B,) number of the group of rows, each of one stratum, that a row was drawn with, see
            `StratifiedBatches`; None: the rows were drawn from all the data.
    """

    x0: Tensor
    x1: Tensor
    c: Tensor | None
    source_index: Tensor
    target_index: Tensor
    weight: Tensor | None = None
    group: Tensor | None = None

    def __post_init__(self) -> None:
        x0, c, shape = self.x0, self.c, np.shape(self.x0)
        if len(shape) != 2 or 0 in shape:
            raise ValueError(f"x0 must have shape (rows, columns) and not be empty, got {shape}")
        validation.check_shape(x0, "x0", shape)
        validation.check_shape(self.x1, "x1", shape)
        if c is not None and not (isinstance(c, Tensor) and c.ndim == 2 and len(c) == len(x0)):
            raise ValueError(f"c must have shape ({len(x0)}, columns), got {validation.short(c)}")
        for name in ("source_index", "target_index", "group"):
            if (value := getattr(self, name)) is not None or name != "group":
                validation.check_index(value, name, len(x0))
        if self.weight is not None:
            _check_weight(self.weight, len(x0))

    def __len__(self) -> int:
        return len(self.x0)

    def __repr__(self) -> str:
        there = ((name, getattr(self, name)) for name in PAIRS_FIELDS)
        shapes = (f"{name} {tuple(x.shape)}" for name, x in there if x is not None)
        return f"Pairs({', '.join(shapes)})"

    def map(self, change: Callable[[Tensor], Tensor]) -> Pairs:
        """Apply `change` to every tensor, for instance to slice it or to move it to a device."""
        given = (getattr(self, name) for name in PAIRS_FIELDS)
        return Pairs._trusted(*(None if value is None else change(value) for value in given))

    def pin_memory(self) -> Pairs:
        """Copy every tensor to pinned memory; a `DataLoader` with pin_memory=True calls this."""
        return self.map(Tensor.pin_memory)

    @staticmethod
    def cat(parts: Sequence[Pairs]) -> Pairs:
        """Concatenate several `Pairs` row by row; groups of each are numbered after those before.

        Raises:
            ValueError: there are none, or only some of them have conditions, weights or groups.
        """
        if len(parts) == 1:
            return parts[0]
        if not parts:
            raise ValueError("parts must be at least one Pairs, got none")
        columns = {name: [getattr(part, name) for part in parts] for name in PAIRS_FIELDS}
        for name, values in columns.items():
            if 0 < sum(value is None for value in values) < len(values):
                raise ValueError(f"parts must all have {name}, or none of them; some have it")
        if columns["group"][0] is not None:  # else those of other strata would meet
            first = itertools.accumulate((int(g.max()) + 1 for g in columns["group"]), initial=0)
            columns["group"] = [g + n for g, n in zip(columns["group"], first, strict=False)]
        whole = (None if c[0] is None else torch.cat(c) for c in columns.values())
        return Pairs._trusted(*whole)

    @classmethod
    def _trusted(cls, *values: Tensor | None) -> Pairs:
        """Parts of pairs that were checked are not checked again, batch by batch."""
        pairs = cls.__new__(cls)
        for name, value in zip(PAIRS_FIELDS, values, strict=True):
            object.__setattr__(pairs, name, value)
        return pairs


PAIRS_FIELDS = tuple(field.name for field in fields(Pairs))


class Sampler(Protocol):
    """Data: an object whose `sample(n, generator=g)` returns (x1, c); c may be None."""

    def sample(self, n: int, generator: Generator | None = None) -> tuple[Tensor, Tensor | None]:
        """Draw x1 of shape (n, d) and c of shape (n, k)."""


class Source(Protocol):
    """Noise: a callable whose `source(n, generator=g)` returns x0 of shape (n, d)."""

    def __call__(self, n: int, generator: Generator | None = None) -> Tensor:
        """Draw n rows in any order: a stream shuffles them, before they meet rows of data."""


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


@dataclass(frozen=True)
class Traits:
    """What a coupling needs, for the code around it.

    Attributes:
        needs_condition: it cannot pair without c.
        needs_network: it must see the network before each batch, by `observe`.
        whole_data: it needs the whole data set; ot_batch_size does not apply.
        uses_ot_batch: a larger ot_batch_size gives each row more candidates.
        solves: pairing takes long enough to be worth a background thread.
        transformable: it pairs rows of a batch by x1 and c alone, and labels them by their data
            (see `Transformed`).
    """

    needs_condition: bool = False
    needs_network: bool = False
    whole_data: bool = False
    uses_ot_batch: bool = False
    solves: bool = True
    transformable: bool = True


@dataclass(repr=False, eq=False)
class Coupling(WithOptions):
    """Pairs noise with data. A new coupling overrides `match`, and nothing else.

    Its options are the fields of a dataclass, `@dataclass(repr=False)`. What it needs it declares
    by `traits`. One that needs the whole data set is given an epoch instead of a batch: see
    `prepare` and `epoch_rows`.
    """

    name = "coupling"
    traits = Traits()

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
            generator: source of randomness; torch's global generator if None. In the workers of a
                DataLoader leave it out: torch seeds each of them differently, but copies of one
                generator draw the same in all, which is warned of.

        Returns:
            `Pairs` of B rows, with the devices and dtypes of the inputs. Inputs are not changed.

        Raises:
            TypeError: an input is not a floating-point tensor, or c is None but needed.
            ValueError: shapes do not match, a batch is empty, or values are not finite, or so large
                or small that their squares are not.
        """
        validation.check_matrix(x0, "x0", hint=validation.IMAGES)
        validation.check_matrix(x1, "x1", columns=x0.shape[1], hint=validation.IMAGES)
        validation.check_same_rows(x1, "x1", x0, "x0")
        if self.traits.solves:
            validation.check_squares(x0=x0, x1=x1)
        seen = self._check_condition(c, x0, "x0")
        validation.check_generator(generator)
        _warn_of_copies(generator)
        with torch.no_grad():  # what a coupling keeps must not hold a graph
            plain = [_without_graph(value) for value in (x0, x1, seen)]
            match = self.matched(plain[0], plain[1], plain[2], _numpy_rng(generator))
        validation.check_has(match, "what match returns", "a Match", *Match._fields)
        rows = x0.shape[0]  # len() of a tensor takes ten times as long
        source, target = (
            _check_rows(getattr(match, name), name, rows).to(x0.device)
            for name in ("source_index", "target_index")
        )
        if match.x1 is None:
            paired = x1[target.to(x1.device)]
        else:
            paired = check_like(match.x1, "x1 of match", x1).to(x1)
        if c is not None:
            label = target
            if match.condition_index is not None:
                label = _check_rows(match.condition_index, "condition_index", rows)
            c = c[label.to(c.device)]
        if match.weight is not None:
            _check_weight(match.weight, rows)
        return Pairs._trusted(x0[source], paired, c, source, target, match.weight, None)

    def matched(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """What `match` chooses; a user's one may overwrite what it is given."""
        if not is_ours(self.match):
            x0, x1, c = lent(x0, x1, c)
        return self.match(x0, x1, c, rng)

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
        `start` continues with the same batches. In the workers of a DataLoader each yields its
        share of them: with batch_size=None and a seeded generator the loader gives the batches of
        one process, in their order. A map-style data set has shared out its items already: put a
        stream into an IterableDataset (else a UserWarning). Where whole epochs are paired, an
        incomplete last batch is dropped, and epochs smaller than a batch are concatenated.

        Args:
            data: has `sample(n, generator=g) -> (x1, c)`; for a coupling of whole data also
                `x1`, `c` and a length.
            batch_size: rows of each yielded `Pairs`.
            ot_batch_size: rows that are paired at once, a multiple of batch_size; batch_size if
                None. More rows help if the coupling's traits say `uses_ot_batch`.
            source: draws the noise; standard normal if None.
            generator: only its initial seed counts; torch's global seed if None.
            start: number of the first batch.

        Raises:
            TypeError: the data have no `sample`, or are endless, but the coupling needs the whole
                data set.
            ValueError: a size is out of range, or ot_batch_size is given to a coupling of whole
                data.
        """
        validation.check_count(batch_size, "batch_size")
        ot_batch_size = batch_size if ot_batch_size is None else ot_batch_size
        validation.check_count(ot_batch_size, "ot_batch_size", minimum=batch_size)
        whole = self.traits.whole_data
        if ot_batch_size % batch_size or (whole and ot_batch_size != batch_size):
            allowed = "equal to" if whole else "a multiple of"  # all the data are paired
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
        worker = get_worker_info()
        seed = torch.initial_seed() if generator is None else generator.initial_seed()
        if worker and generator is None:
            seed = worker.seed - worker.id  # that of all workers, who share the batches
        if worker and worker.num_workers > 1 and not isinstance(worker.dataset, IterableDataset):
            warnings.warn(
                "a stream in a worker of a map-style data set yields this worker's share of the "
                "batches, so that start=i does not begin with batch i: put it into an "
                "IterableDataset, or pair each batch by a call of the coupling",
                stacklevel=2,
            )
        if whole:
            _warn_of_own_sample(self, data)
        epoch = self.epoch_rows(data)
        own = self.prepared(data, source, generator_for(seed, 0, Purpose.PREPARATION))
        turn = own._last_turn()
        rows, solves = ot_batch_size, 1
        if epoch:  # a batch may take several of them
            rows, solves = epoch, math.ceil(batch_size / epoch)
        count = solves * rows // batch_size  # batches that are paired at once
        workers, mine = (worker.num_workers, worker.id) if worker else (1, 0)
        for number in itertools.count(start // count):
            first = number * count
            turns = range(first + (start + mine - first) % workers, first + count, workers)
            places = [k - first for k in turns if k >= start]
            if not places:
                continue
            validation.check_default_device()
            if own._last_turn() is not turn:
                raise RuntimeError(
                    f"another stream has prepared this {type(self).__name__} for its own data: "
                    "take a coupling for each stream, or override `prepared`"
                )
            generators = [generator_for(seed, number * solves + k) for k in range(solves)]
            pairs = Pairs.cat([own.solve(data, rows, source, rng) for rng in generators])
            if len(pairs) != solves * rows:
                own_name = type(self).__name__
                raise ValueError(
                    f"solve of {own_name} must return {solves * rows} pairs, got {len(pairs)}"
                )
            if epoch:  # its pairs are ordered by cluster
                shuffle = generator_for(seed, number, Purpose.ORDER)
                pairs = pairs.map(itemgetter(torch.randperm(len(pairs), generator=shuffle)))
            for k in places:
                _check_worker(worker)
                part = slice(k * batch_size, (k + 1) * batch_size)
                yield pairs if len(pairs) == batch_size else pairs.map(itemgetter(part))

    def prepare(self, data: Any, source: Source | None, generator: Generator) -> None:
        """Fit clusters or potentials to the data before the first batch of a stream."""

    def prepared(self, data: Any, source: Source | None, generator: Generator) -> Coupling:
        """Prepare, and return what pairs the batches of the stream.

        It is this coupling, and a stream goes on only until another one prepares it. A coupling
        whose streams should not meet overrides this method, and returns a copy that keeps what
        `prepare` fitted.
        """
        self.prepare(data, source, generator)
        if type(self).prepare is not Coupling.prepare:
            self._turn = object()
        return self

    def _last_turn(self) -> object:
        """What tells the last stream that prepared this coupling from those before."""
        return getattr(self, "_turn", None)

    def epoch_rows(self, data: Any) -> int:
        """Rows of an epoch if a whole epoch is paired at once; 0 if batches are.

        They come from `draw`, which for a `Dataset` draws with replacement: override it, too.
        """
        return 0

    def draw(self, data: Any, n: int, generator: Generator) -> tuple[Tensor, Tensor | None]:
        """Draw the n rows (x1, c) that a stream pairs at once."""
        return draw_rows(data, n, generator)

    def solve(self, data: Any, n: int, source: Source | None, generator: Generator) -> Pairs:
        """Draw n rows of data and noise for a stream, and pair them."""
        x1, c = self.draw(data, n, generator)
        x0 = shuffled_noise(x1, source, generator)
        own = _OF_A_STREAM.set(generator)
        try:
            return self(x0, x1, c, generator)
        finally:
            _OF_A_STREAM.reset(own)

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

    def _check_condition(self, c: Tensor | None, x: Tensor, name: str) -> Tensor | None:
        """Return c as floating point, or None, if c are conditions of the rows of x.

        Raises:
            TypeError: c is no tensor of real numbers, or None but needed.
            ValueError: its shape does not fit, or values are not finite.
        """
        if c is not None:
            c = validation.check_condition(c)
            validation.check_same_rows(c, "c", x, name)
        elif self.traits.needs_condition:
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")
        return c

    def _rows_of(self, data: Any, index: Tensor) -> tuple[Tensor, Any]:
        """Rows (x1, c) of data, checked: they may have been refilled since a stream began."""
        x1 = validation.check_matrix(data.x1[index], "x1 of the data")
        c = None if data.c is None else data.c[index]
        self._check_condition(c, x1, "x1 of the data")
        return x1, c

    def _check_finite(self, data: Any) -> None:
        """Raise TypeError unless the data have `x1`, `c` and a length."""
        if not all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            raise TypeError(
                f"{type(self).__name__} needs finite data with x1, c and len, got endless data: "
                "draw a Dataset from them, or give n_samples to StratifiedOT"
            )


class Batches(Coupling):
    """A coupling that yields existing batches of `Pairs`.

    They come as they are, with the rows that they have, whatever batch_size a stream is asked for.
    """

    traits = Traits(solves=False)

    def __init__(self, batches: Iterator[Pairs]) -> None:
        self._batches = batches

    def stream(
        self, data: Sampler, *, start: int = 0, source: Source | None = None, **options: Any
    ) -> Iterator[Pairs]:
        """The batches from number `start` on; a worker of a DataLoader yields its share of them."""
        if source is not None:
            raise ValueError("source must be None: Batches have noise of their own")
        for skipped in range(validation.check_count(start, "start", minimum=0)):
            if next(self._batches, None) is None:
                raise ValueError(f"start must be below the number of batches, {skipped}")
        worker = get_worker_info()
        step, first = (worker.num_workers, worker.id) if worker else (1, 0)
        for pairs in itertools.islice(self._batches, first, None, step):
            _check_worker(worker)
            yield pairs

    def solve(self, data: Any, n: int, source: Source | None, generator: Generator) -> Pairs:
        """The next batch."""
        return next(self._batches)


class Last:
    """A cache of a function's last value, reused while its tensors have the same content.

    Identity would not do: buffers are refilled in place, and so are the tensors of a data set.
    Content and value are one tuple, so that threads can share the cache.
    """

    def __init__(self) -> None:
        self._kept: tuple[list[bytes], Any] = ([], None)

    @property
    def value(self) -> Any:
        """The last value, or None."""
        return self._kept[1]

    def __call__(self, function: Callable[..., Any], *tensors: Tensor) -> Any:
        """The function's value for these tensors, from the cache if they are the last ones."""
        content = [content_of(value) for value in tensors]
        kept = self._kept
        if content != kept[0]:
            kept = self._kept = (content, function(*tensors))
        return kept[1]


def lent(*values: Any) -> list[Any]:
    """Copies of the tensors among these values, for a user's function that may overwrite them."""
    return [value.clone() if isinstance(value, Tensor) else value for value in values]


def is_ours(function: Any) -> bool:
    """Whether a function is of this package, which overwrites nothing that it is given."""
    return str(getattr(function, "__module__", "")).startswith("cotlearn.")


def _without_graph(value: Any) -> Any:
    """The same tensor, or its data if it has gradients."""
    return value.detach() if isinstance(value, Tensor) and value.requires_grad else value


OPTIONS = "options"  #: the key of how a coupling prints, in a state


def written(coupling: Coupling) -> Tensor:
    """How a coupling prints, as bytes, for its state."""
    return torch.tensor(list(repr(coupling).encode()), dtype=torch.uint8)


def check_written(state: dict[str, Tensor], coupling: Coupling) -> None:
    """Raise ValueError if a state is of a coupling with other options."""
    if OPTIONS in state and (then := bytes(state[OPTIONS].tolist()).decode()) != repr(coupling):
        raise ValueError(f"state is of {then}, and this is {coupling!r}")


def content_of(value: Tensor) -> bytes:
    """A digest of a tensor: equal only for equal numbers, shapes and types."""
    array = value.detach().cpu().contiguous()
    found = hashlib.blake2b(f"{array.dtype} {tuple(array.shape)}".encode(), digest_size=16)
    found.update(array.reshape(-1).view(torch.uint8).numpy().data)
    return found.digest()


def check_like(value: Any, name: str, x: Tensor) -> Tensor:
    """Return a user function's `value` if it is finite and has the shape of x (B, d)."""
    return validation.check_matrix(validation.check_shape(value, name, tuple(x.shape)), name)


def _check_weight(weight: Any, rows: int) -> None:
    """Raise an error unless these are finite weights of rows, at least 0."""
    validation.check_shape(weight, "weight", (rows,))
    if not (weight >= 0).all():
        raise ValueError(f"weight must be at least 0, got {float(weight.min()):.3g}")
    if not weight.isfinite().all():
        raise ValueError("weight must be finite, got inf")


def draw_noise(x1: Tensor, source: Source | None, generator: Generator | None) -> Tensor:
    """Draw noise with the shape of x1 (n, d), standard normal unless a source is given."""
    if source is None:
        return torch.randn(x1.shape, dtype=x1.dtype, generator=generator)
    drawn = _asked(source, "source", len(x1), generator)
    noise = validation.check_shape(drawn, "source(n)", tuple(x1.shape))
    noise = noise.to(x1, copy=True)  # a source may fill the same buffer again
    return validation.check_matrix(noise, f"source(n) in {x1.dtype}")


def shuffled_noise(x1: Tensor, source: Source | None, generator: Generator) -> Tensor:
    """As `draw_noise`, but rows of a source, which may have an order, do not meet x1's in it."""
    noise = draw_noise(x1, source, generator)
    if source is None:
        return noise
    return noise[torch.randperm(len(noise), generator=generator)]


def _asked(function: Callable[..., Any], name: str, n: int, generator: Generator | None) -> Any:
    """What a user's function draws; one that takes no generator is refused by name."""
    try:
        return function(n, generator=generator)
    except TypeError as error:
        if "unexpected keyword argument 'generator'" not in str(error):
            raise
        raise TypeError(f"{name} must take (n, generator=...), as Dataset.sample does") from error


def draw_rows(data: Sampler, n: int, generator: Generator | None) -> tuple[Tensor, Tensor | None]:
    """Draw n rows (x1, c) by `data.sample`.

    Raises:
        TypeError: it returns something else than a tuple (x1, c) of tensors; c may be None.
        ValueError: it returns another number of rows.
    """
    drawn = _asked(data.sample, "data.sample", n, generator)
    if not (isinstance(drawn, tuple) and len(drawn) == 2):
        raise TypeError(f"data.sample(n) must return (x1, c), got {type(drawn).__name__}")
    for name, rows in zip(("x1", "c"), drawn, strict=True):
        if not isinstance(rows, Tensor) and not (name == "c" and rows is None):
            kind = type(rows).__name__
            raise TypeError(f"data.sample(n) must return {name} as a torch tensor, got {kind}")
        if rows is not None and name == "x1" and not rows.is_floating_point():
            raise TypeError(f"data.sample(n) must return x1 as floating point, got {rows.dtype}")
        if rows is not None and (not rows.ndim or len(rows) != n):
            got = tuple(rows.shape)
            raise ValueError(f"data.sample({n}) must return {n} rows of {name}, got shape {got}")
    return drawn


def _check_rows(value: Any, name: str, rows: int) -> Tensor:
    """Return what `match` gave for `name` as row numbers (rows,)."""
    index = np.array(value.cpu() if isinstance(value, Tensor) else value)
    whole = index.dtype.kind in "iu"
    if not whole or index.shape != (rows,) or not 0 <= index.min() <= index.max() < rows:
        got = f"{index.dtype} of shape {index.shape}"
        if whole and index.size:
            got += f" from {index.min()} to {index.max()}"
        raise ValueError(f"match must give {name} as {rows} rows from 0 to {rows - 1}, got {got}")
    return torch.from_numpy(index.astype(np.int64, copy=False))


def _check_worker(begun_in: Any) -> None:
    """Raise RuntimeError in a DataLoader's worker that got a stream which another process began."""
    worker = get_worker_info()
    if worker and worker is not begun_in and worker.num_workers > 1:
        raise RuntimeError(
            "this stream was begun before the DataLoader's workers, which would all yield the same "
            "batches: call stream(...) in each worker, in the data set's __iter__"
        )


def _warn_of_own_sample(coupling: Coupling, data: Any) -> None:
    """Warn of data that draw rows in a way of their own, which a coupling of whole data ignores."""
    own = getattr(type(data), "sample", None)
    if isinstance(data, Dataset) and own is not Dataset.sample:
        warnings.warn(
            f"{type(coupling).__name__} takes the rows x1 and c of all the data, and does not call "
            f"{type(data).__name__}.sample: rows are not drawn by it",
            stacklevel=4,
        )


def _warn_of_copies(generator: Generator | None) -> None:
    """Warn in a DataLoader's worker about a generator that other workers may have as well."""
    worker = get_worker_info()
    if generator is None or generator is _OF_A_STREAM.get():
        return
    if worker and generator.initial_seed() != worker.seed:
        warnings.warn(
            "generator: a generator made before the DataLoader's workers draws the same in each "
            "of them; pass none, in noise as well, or seed one by get_worker_info().seed",
            stacklevel=3,
        )


def _numpy_rng(generator: Generator | None) -> np.random.Generator:
    device = "cpu" if generator is None else generator.device
    seed = torch.randint(2**62, (1,), generator=generator, device=device)
    return np.random.default_rng(int(seed))
