"""The frontier: prior skew against one-step variance of couplings, without training a network."""

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import Array, Coupling, Pairs
from cotlearn.couplings.distances import to_numpy
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import skew
from cotlearn.diagnostics.groups import held_out
from cotlearn.diagnostics.probe import one_step_scores
from cotlearn.diagnostics.skew import LinearSkew
from cotlearn.diagnostics.spread import local_variance
from cotlearn.metrics import Interval, bootstrap_interval, joint_squared_w2
from cotlearn.progress import progress_bar
from cotlearn.randomness import Purpose, generator_for
from cotlearn.validation import check_count, check_has, check_seed

FEWEST = 100  #: rows of data
NEIGHBOURS = 10  #: for the estimates of E[x1 | x0, c] and Var(x1 | x0, c)
RESAMPLES = 500  #: of the bootstrap


@dataclass(frozen=True)
class FrontierPoint:
    """One coupling on the frontier.

    Attributes:
        name: its key in `frontier(couplings=...)`.
        coupling: `Coupling.name`, for its colour.
        skew: statistic of `prior_skew`; 0 means no skew.
        skew_interval: 95 % Student interval over repetitions. (A bootstrap over rows ignores that
            neighbouring rows are dependent: on three mixtures it covered the mean of 60 runs in
            only 73 to 83 % of the runs, Student's interval in 90 to 95 %.)
        flagged: whether the skew is significant.
        one_step_variance: E tr Var(x1 | x0, c), by nearest neighbours.
        one_step_variance_interval: 95 % bootstrap interval over rows.
        one_step_error: squared W2 (jointly with c) between E[x1 | x0, c], estimated by nearest
            neighbours at fresh x0, and held-out data: the expected error of a one-step model.
        candidates: data rows that a noise row can choose from (see `Coupling.candidates`).
        transport_cost: E |x1 - x0|^2.
        seconds: time to make 1,000 pairs.
        linear_skew: `linear_skew` of all pairs; None if there are too few for the dimension.
        scores: (n,) energy scores of a probe's one-step samples on n held-out rows, the same rows
            for all couplings (see `one_step_scores`); None if probe_steps is 0.
    """

    name: str
    coupling: str
    skew: float
    skew_interval: Interval
    flagged: bool
    one_step_variance: float
    one_step_variance_interval: Interval
    one_step_error: float
    candidates: float
    transport_cost: float
    seconds: float
    linear_skew: LinearSkew | None = None
    scores: Tensor | None = field(default=None, repr=False, compare=False)

    @property
    def one_step_score(self) -> float:
        """The mean of `scores`; NaN if there are none."""
        return math.nan if self.scores is None else float(self.scores.mean())


@dataclass(frozen=True)
class Frontier:
    """The points of all couplings in the given order; `frontier[name]` looks one up."""

    points: tuple[FrontierPoint, ...]

    def __iter__(self) -> Iterator[FrontierPoint]:
        return iter(self.points)

    def __len__(self) -> int:
        return len(self.points)

    def __getitem__(self, name: str) -> FrontierPoint:
        for point in self.points:
            if point.name == name:
                return point
        raise KeyError(f"no coupling {name!r}; expected one of {[p.name for p in self.points]}")


def frontier(
    x1: Tensor,
    c: Tensor,
    couplings: Mapping[str, Coupling],
    *,
    batch_size: int = 256,
    rows: int = 4096,
    repetitions: int = 3,
    probe_steps: int = 0,
    groups: Any = None,
    seed: int = 0,
    progress: bool | None = None,
) -> Frontier:
    """Estimate the prior skew and one-step variance of each coupling, before any training.

    Independent pairs have no skew and the largest one-step variance; naive OT has the opposite. The
    weight of a conditional coupling trades one for the other, and more candidates move the
    trade-off closer to the origin.

    Args:
        x1: (N, d) training data, N at least 100.
        c: (N, k) their conditions.
        couplings: name -> coupling.
        batch_size: rows of an OT batch, for couplings that pair batches.
        rows: pairs to examine in each repetition, at least 100.
        repetitions: independent draws of pairs, at least 2.
        probe_steps: train a small network at t = 0 for this many steps on each coupling's pairs,
            and score it on held-out rows (500 steps take about a second); 0 trains nothing.
        groups: (N,), rows with the same value are held out together, as those of one episode; if
            None, each row alone.
        seed: of the held-out rows, the pairs and the probe.
        progress: show a progress bar; if None, in terminals and notebooks.

    Raises:
        ValueError: too few rows, no couplings, or an option out of range.
    """
    c = skew.check_conditioned(x1, "x1", c)
    if len(x1) < FEWEST:
        raise ValueError(f"x1 needs at least {FEWEST} rows for a frontier, got {len(x1)}")
    if not check_has(couplings, "couplings", "a dict of names and couplings", "items"):
        raise ValueError("couplings is empty: give at least one name and coupling")
    check_count(batch_size, "batch_size", minimum=2)
    seed = check_seed(seed)
    check_count(rows, "rows", minimum=skew.MINIMUM_ROWS)
    check_count(repetitions, "repetitions", minimum=2)
    check_count(probe_steps, "probe_steps", minimum=0)
    train, test = held_out(x1, c, seed, groups)
    batch_size = min(batch_size, len(train))
    points = []
    with progress_bar(total=len(couplings), what="couplings compared", show=progress) as bar:
        for name, coupling in couplings.items():
            check_has(
                coupling, f"couplings[{name!r}]", "a coupling such as Independent()", "stream"
            )
            seeds = range(seed, seed + repetitions)
            drawn = [_draw(coupling, train, batch_size, rows, one) for one in seeds]
            draws, seconds = zip(*drawn, strict=True)
            batch = draws[0].map(lambda value: value[:batch_size])
            known: dict[str, Any] = {"name": name, "coupling": coupling.name}
            known["seconds"] = 1000 * float(np.mean(seconds))
            known["candidates"] = coupling.candidates(batch.x0, batch.x1, batch.c)
            if probe_steps:
                all_pairs = Pairs.cat(draws)
                known["scores"] = one_step_scores(all_pairs, test, steps=probe_steps, seed=seed)
            points.append(_point(draws, test, seed, **known))
            bar.update()
    return Frontier(tuple(points))


def _draw(
    coupling: Coupling, data: Dataset, batch_size: int, rows: int, seed: int
) -> tuple[Pairs, float]:
    """Draw about `rows` pairs in whole batches; return them and the seconds per pair.

    Pairs with weights are kept with a probability proportional to their weight.
    """
    generator = torch.Generator().manual_seed(seed)
    stream = coupling.stream(data, batch_size=batch_size, generator=generator)
    next(stream)  # fits clusters and potentials, which is not timed
    wanted = math.ceil(rows / batch_size)
    epoch = max(1, coupling.epoch_rows(data) // batch_size)
    batches = math.ceil(wanted / epoch) * epoch  # whole epochs: one batch pays for pairing each
    started = time.perf_counter()
    parts = [next(stream) for _ in range(batches)]
    seconds = (time.perf_counter() - started) / (batches * batch_size)
    pairs = Pairs.cat(parts[:wanted])
    if pairs.weight is not None:
        luck = torch.rand(len(pairs), generator=generator_for(seed, 0, Purpose.WEIGHTED_PAIRS))
        kept = luck < pairs.weight / pairs.weight.max()
        pairs = replace(pairs, weight=None).map(lambda value: value[kept])
    return pairs, seconds


def _point(draws: Any, test: Dataset, seed: int, **known: Any) -> FrontierPoint:
    """Estimate a coupling's `FrontierPoint` from several draws of pairs."""
    skews = [
        skew.prior_skew(pairs.x0, pairs.c, generator=generator_for(seed, number, Purpose.SKEW))
        for number, pairs in enumerate(draws)
    ]
    statistics = np.array([found.statistic for found in skews])
    middle = float(statistics.mean())
    from scipy import stats  # late: it takes a second

    reach = float(stats.t.ppf(0.975, len(skews) - 1) * stats.sem(statistics))
    pairs: Any = draws[0]
    pool = torch.cat([p.x0 for p in draws]), torch.cat([p.c for p in draws])
    variance = local_variance(_places(pairs, pairs.x0, pairs.c), to_numpy(pairs.x1), NEIGHBOURS)
    return FrontierPoint(
        skew=middle,
        skew_interval=(middle - reach, middle + reach),
        flagged=float(np.median([found.p_value for found in skews])) <= skew.SIGNIFICANCE,
        one_step_variance=float(variance.mean()),
        one_step_variance_interval=bootstrap_interval(variance, seed=seed, resamples=RESAMPLES),
        one_step_error=float(np.mean([one_step_error(p, test, seed) for p in draws])),
        transport_cost=float((pairs.x1.double() - pairs.x0.double()).square().sum(dim=1).mean()),
        linear_skew=skew.linear_skew(*pool) if skew.enough_rows(*pool) else None,
        **known,
    )


def _places(pairs: Any, x0: Tensor, c: Tensor) -> Array:
    """Rows (x0, c); noise and condition are scaled to equal variance over the pairs."""
    given = ((x0, pairs.x0), (c, pairs.c))
    return np.hstack([skew.unit_variance(to_numpy(new), to_numpy(old)) for new, old in given])


def one_step_error(pairs: Any, test: Any, seed: int = 0) -> float:
    """Squared W2 between E[x1 | x0, c] at fresh noise and held-out x1, jointly with c.

    A one-step model learns this conditional mean; here it is estimated by the mean over the 10
    nearest pairs. A skewed coupling has no near pairs at fresh noise, which raises its error.

    Args:
        pairs: `Pairs` of a coupling, with conditions.
        test: held-out `Dataset`; at most 1,000 rows are used.
        seed: of the rows and the fresh noise.
    """
    rng = generator_for(seed, 0, Purpose.ONE_STEP_ERROR)
    rows = torch.randperm(len(test), generator=rng)[:1000]
    x0 = pairs.x0[torch.randperm(len(pairs), generator=rng)[: len(rows)]]
    rows = rows[: len(x0)]
    fresh, places = _places(pairs, x0, test.c[rows]), _places(pairs, pairs.x0, pairs.c)
    index = skew.nearest(places, NEIGHBOURS, of=fresh)
    mean = torch.from_numpy(to_numpy(pairs.x1)[index].mean(axis=1))
    return joint_squared_w2(mean, test.x1[rows].double(), test.c[rows])
