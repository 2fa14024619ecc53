"""Conditional semidiscrete OT: the noise is continuous, the target is the whole data set."""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import (
    Coupling,
    Match,
    Pairs,
    Source,
    StreamOptions,
    draw_noise,
    generator_for,
    squared_distances,
)
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.progress import progress_bar
from cotlearn.validation import (
    check_condition,
    check_count,
    check_matrix,
    check_number,
    check_same_rows,
)

UNCONVERGED = 0.1  #: marginal error above its floor that is worth a warning
DRAWS_PER_ROW = 200  #: noise rows that a fit draws for each row of the data
FEWEST_STEPS = 500  #: of a fit to few rows
LARGEST_SEARCH = 1e11  #: heights that a fit looks at by default, at most
FIRST_STEP, LAST_STEP = 0.05, 0.1  #: of the spread of costs, and of the costs between neighbours
HEIGHTS_AT_ONCE, POINTS_AT_ONCE = 300_000, 4096  #: what the processor's cache holds
AVERAGED = 0.3  #: the last share of the steps, whose mean is the potential


class SemidiscreteOT(Coupling):
    """Noise (x0, c0) meets row argmin_j |x0 - x1_j|^2 + w |c0 - c_j|^2 - phi_j of all the data.

    The dual potential phi is fitted once, by averaged stochastic gradient ascent of the
    semidiscrete dual (Genevay 1605.08527): a row that is chosen more often than 1/N gets dearer.
    Pairing is then a search, and no batch limits the candidates. This project's own: semidiscrete
    flow matching (2509.25519) has no condition term.

    How long to fit. From M draws no method can know the marginal better than to about
    0.4 sqrt(N/M), so the default is M = 200 N, and fewer only where that would look at more than
    1e11 heights (N/K for each draw; minutes). The step falls geometrically, from a share of the
    spread of all costs to a share of the costs between neighbouring rows, because a single draw
    must at first carry a row far and in the end not past its neighbours; the last 30 % of the
    steps are averaged.

    The data of a stream are finite (`.x1`, `.c` and `len`), or endless with n_samples.

    Measured as the excess sqrt(marginal_error^2 - marginal_floor^2), with the CPU seconds of the
    fit: N = 1e3 in 2 to 32 dimensions .05 to .06 (1 s); the digits, 64 dimensions, .05 (4 s);
    N = 1e4 in 2 dimensions .06 to .07 (25 to 29 s); N = 2e4 in 2 clusters .09, in 64 clusters .06;
    N = 1e5 in 64 clusters, 2 dimensions .09 (a step now takes 10 ms, in 32 dimensions 20 ms, and
    there are 6,400). Larger N without clusters, or in many dimensions, was not measured.

    Args:
        condition_weight: w, at least 0.
        clusters: K; None for none. With clusters noise and data meet only within their condition
            cluster (w still counts inside), and a search looks at N/K rows instead of N.
        iterations: steps of the ascent, at least 1; by default enough for 200 draws a row.
        batch_size: noise rows of each step; by default N/32, but from 64 to 4,096.
        n_samples: rows drawn once as the data set where the data are an endless sampler.
        seed: of the fit.

    Attributes:
        marginal_error: after the fit, the total variation distance in [0, 1] between how often the
            rows are chosen and 1/N each, on fresh noise; `marginal_floor` is what as many draws
            from the exact marginal show.

    Raises:
        TypeError: the data are endless and n_samples is None, or c is missing where needed.
        ValueError: an option out of range.
    """

    name = "semidiscrete"
    whole_data = True

    def __init__(
        self,
        condition_weight: float = 0.0,
        *,
        clusters: int | None = None,
        iterations: int | None = None,
        batch_size: int | None = None,
        n_samples: int | None = None,
        seed: int = 0,
    ) -> None:
        self.condition_weight = check_number(condition_weight, "condition_weight")
        self.clusters = None if clusters is None else check_count(clusters, "clusters")
        self.iterations = None if iterations is None else check_count(iterations, "iterations")
        self.batch_size = None if batch_size is None else check_count(batch_size, "batch_size")
        self.n_samples = None if n_samples is None else check_count(n_samples, "n_samples")
        self.seed = check_count(seed, "seed", minimum=0)
        self._x1: Tensor | None = None
        self._c: Tensor | None = None
        self._label: Tensor | None = None
        self._centre = torch.zeros(())
        self._groups: list[Tensor] = []
        self._points: list[Tensor] = []  # the features of each group, and their squared norms
        self._squares: list[Tensor] = []
        self._phi: Tensor | None = None
        self._errors = (math.nan, math.nan)
        self._fitted_to: tuple[Source | None, ...] = ()  # the noise, where it is known

    @property
    def marginal_error(self) -> float:
        """Total variation distance between chosen and wanted frequencies; NaN before the fit."""
        return self._errors[0]

    @property
    def marginal_floor(self) -> float:
        """What the same number of exact draws would show; NaN before the fit."""
        return self._errors[1]

    def __repr__(self) -> str:
        names = ("condition_weight", "clusters", "iterations", "batch_size", "n_samples", "seed")
        return f"SemidiscreteOT({', '.join(f'{n}={getattr(self, n)!r}' for n in names)})"

    def fit(
        self,
        x1: Tensor,
        c: Tensor | None = None,
        *,
        source: Source | None = None,
        progress: bool | None = None,
    ) -> SemidiscreteOT:
        """Fit the potential on the data set x1 (N, d), c (N, k).

        Args:
            x1: the whole data set.
            c: its conditions; needed unless w is 0 and there are no clusters.
            source: draws the noise; standard normal if None.
            progress: show a bar; None: in terminals and notebooks.
        """
        self._prepare(x1, c)
        iterations, batch_size = self._effort()
        few = min(1.0, len(x1) / batch_size)  # rows that are chosen several times in one step
        first, last = (few * step for step in self._steps(source))
        phi = torch.zeros(len(x1), dtype=torch.float64)
        average = torch.zeros_like(phi)
        wanted = batch_size / len(x1)
        bar = progress_bar(total=iterations, what="potentials", show=progress)
        with bar:
            for step in range(iterations):
                self._phi = phi
                rng = generator_for(self.seed, step, purpose=4)
                _, chosen = self._draw(batch_size, source, rng)
                rate = first * (last / first) ** (step / iterations)
                phi = phi + rate * (wanted - torch.bincount(chosen, minlength=len(x1)))
                averaged = 1 + max(0, step - int((1 - AVERAGED) * iterations))
                average += (phi - average) / averaged
                bar.update()
        self._phi = average
        self._errors = self._marginal(source)
        if self.marginal_error > self.marginal_floor + UNCONVERGED:
            warnings.warn(
                f"the potential has not converged: rows are chosen {self.marginal_error:.2f} away "
                f"from equally often (as many exact draws: {self.marginal_floor:.2f}), so that the "
                f"pairs' data are not your data; raise iterations above {iterations}",
                RuntimeWarning,
                stacklevel=2,
            )
        self._fitted_to = (source,)
        return self

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Rows of the cluster in all the data, with a weight those of near conditions only."""
        if self._x1 is None:
            return 1.0
        sizes = torch.tensor([float(len(group)) for group in self._groups])
        number = float((sizes**2).sum() / sizes.sum())
        if not self.condition_weight or self._c is None:
            return number
        self.check_batch(x0, x1, c)
        rows = torch.randperm(len(self._x1), generator=generator_for(self.seed, 0, purpose=9))[:512]
        cost = self.condition_weight * squared_distances(self._c[rows], self._c[rows])
        near = cost <= squared_distances(x0, x1).mean()
        return float(number * near.mean())

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Search the batch's own rows, to which the potential is fitted if it is not yet.

        Row i of the noise has the condition of row i. Rows can be chosen more than once: use
        `stream` with the whole data set for training.
        """
        if not self._is_fitted_to(x1, c):
            self.fit(x1, c, progress=False)
        rows = torch.arange(len(x0))
        return Match(rows.numpy(), self._search(x0.to(self._data), rows).numpy())

    def batches(self, data: Any, options: StreamOptions) -> Iterator[Pairs]:
        """Batches of fresh noise, with a condition drawn from the data, and what it meets."""
        x1, c = self._whole(data)
        if not self._is_fitted_to(x1, c) or self._fitted_to not in ((), (options.source,)):
            self.fit(x1, c, source=options.source)
        for number in itertools.count(options.start):
            rng = generator_for(options.seed, number)
            x0, chosen = self._draw(options.batch_size, options.source, rng)
            label = None if c is None else c[chosen]
            yield Pairs(x0.to(x1.dtype), x1[chosen], label, torch.arange(len(x0)), chosen)

    @property
    def _data(self) -> Tensor:
        assert self._x1 is not None
        return self._x1

    def _prepare(self, x1: Tensor, c: Tensor | None) -> None:
        check_matrix(x1, "x1")
        if c is not None:
            check_same_rows(check_condition(c), "c", x1, "x1")
        if c is None and (self.condition_weight or self.clusters):
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")
        self._x1 = x1.detach().to("cpu", torch.float32)
        self._c = None if c is None else check_condition(c).detach().to("cpu", torch.float32)
        self._centre = torch.zeros(()) if self._c is None else self._c.mean(dim=0)
        self._label = torch.zeros(len(x1), dtype=torch.long)
        if self.clusters is not None and self._c is not None:
            self._label = (
                KMeansCondition(self.clusters, seed=self.seed).fit(self._c).labels(self._c)
            )
        order = self._label.argsort(stable=True)
        counts = torch.bincount(self._label)
        self._groups = list(order.split(counts.tolist()))
        self._points = [self._features(self._x1[group], group) for group in self._groups]
        self._squares = [points.square().sum(dim=1) for points in self._points]

    def _whole(self, data: Any) -> tuple[Tensor, Tensor | None]:
        if all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            return data.x1, data.c
        if self.n_samples is None:
            raise TypeError(
                f"{type(self).__name__} looks at the whole data set, but these data are endless "
                "(they have no x1, c and len): give n_samples=, the rows to draw"
            )
        rng = generator_for(self.seed, 0, purpose=3)
        x1, c = data.sample(self.n_samples, generator=rng)
        return x1, c

    def _is_fitted_to(self, x1: Tensor, c: Tensor | None) -> bool:
        if self._phi is None or self._x1 is None or self._x1.shape != x1.shape:
            return False
        same_c = (c is None) == (self._c is None)
        if same_c and c is not None and self._c is not None:
            same_c = torch.equal(self._c, check_condition(c).detach().to(self._c))
        return same_c and torch.equal(self._x1, x1.detach().to(self._x1))

    def _draw(self, n: int, source: Source | None, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Fresh noise (n, d), each with the condition of a random row, and the rows it meets."""
        own = torch.randint(len(self._data), (n,), generator=rng)
        x0 = draw_noise(self._data[own], source, rng)
        return x0, self._search(x0, own)

    def _search(self, x0: Tensor, own: Tensor) -> Tensor:
        """The row of the data that each (x0, c[own]) meets, (n,)."""
        assert self._label is not None
        assert self._phi is not None
        queries = self._features(x0, own)
        label = self._label[own]
        counts = torch.bincount(label, minlength=len(self._groups)).tolist()
        chosen = torch.empty(len(x0), dtype=torch.long)
        for k, rows in enumerate(label.argsort().split(counts)):
            if not len(rows):
                continue
            group, points = self._groups[k], self._points[k]
            # |f - F_j|^2 - phi_j without |f|^2, which is the same for every j
            height = self._squares[k] - self._phi[group]
            chosen[rows] = group[_lowest(queries[rows], points, height)]
        return chosen

    def _features(self, x: Tensor, own: Tensor) -> Tensor:
        """(x, sqrt(w) c), whose squared distance is the cost; float64, so that w may be large."""
        if not self.condition_weight or self._c is None:
            return x.double()
        scaled = math.sqrt(self.condition_weight) * (self._c[own] - self._centre).double()
        return torch.cat([x.double(), scaled], dim=1)

    def _effort(self) -> tuple[int, int]:
        """Iterations and the batch size of each, for these data."""
        n = len(self._data)
        batch_size = self.batch_size or min(max(n // 32, 64), 4096)
        searched = sum(len(group) ** 2 for group in self._groups) / n  # rows, for one draw
        draws = max(DRAWS_PER_ROW * n, FEWEST_STEPS * batch_size)
        draws = min(draws, int(LARGEST_SEARCH / searched))
        return self.iterations or math.ceil(draws / batch_size), batch_size

    def _steps(self, source: Source | None) -> tuple[float, float]:
        """By how much one draw lowers the potential of the row it chose: at first, and at last."""
        rng = generator_for(self.seed, 0, purpose=5)
        own = torch.randint(len(self._data), (256,), generator=rng)
        cost = torch.cdist(draw_noise(self._data[own], source, rng), self._data[own]).square()
        self._warn_if_imprecise(float(cost.mean()))
        first = FIRST_STEP * float(cost.std())
        if not first > 0:
            return 1.0, 1.0  # all costs are equal, and so is what is chosen
        rows = torch.arange(len(self._data))
        x0 = draw_noise(self._data, source, rng)
        last = LAST_STEP * self._gap(self._features(x0, rows), rng)
        last *= self._gap(self._features(self._data, rows), rng)
        return first, min(max(last, 1e-6 * first), first) if math.isfinite(last) else first

    def _gap(self, features: Tensor, rng: torch.Generator) -> float:
        """The median distance of some 256 rows to their nearest other of the cluster, (N, m)."""
        gaps = []
        for group in self._groups:
            some = torch.randperm(len(group), generator=rng)[: 1 + 256 // len(self._groups)]
            distance = torch.cdist(features[group[some]], features[group])
            distance[distance <= 0] = math.inf  # itself, and its duplicates
            gaps.append(distance.min(dim=1).values)
        return float(torch.cat(gaps).median())

    def _warn_if_imprecise(self, sample_cost: float) -> None:
        """Say so if rounding of a height is no longer small against the sample's cost."""
        if not self.condition_weight or self._c is None:
            return
        largest = float((self._c - self._centre).double().square().sum(dim=1).max())
        largest *= self.condition_weight
        if np.finfo(np.float64).eps * largest > 1e-3 * sample_cost:
            warnings.warn(
                f"condition_weight {self.condition_weight:.3g} makes the condition's cost up to "
                f"{largest:.3g}, so large that the search cannot resolve the sample's cost "
                f"({sample_cost:.3g} on average); use a smaller weight, or clusters",
                RuntimeWarning,
                stacklevel=4,
            )

    def _marginal(self, source: Source | None) -> tuple[float, float]:
        """Total variation distance to the uniform marginal, and its floor for as many draws."""
        n = len(self._data)
        draws = min(max(20 * n, 20_000), 400_000)
        rng = generator_for(self.seed, 0, purpose=6)
        counts = torch.zeros(n)
        for size in _sizes(draws, 4096):
            counts += torch.bincount(self._draw(size, source, rng)[1], minlength=n)
        exact = torch.bincount(torch.randint(n, (draws,), generator=rng), minlength=n)
        error, floor = ((k / draws - 1 / n).abs().sum() / 2 for k in (counts, exact))
        return float(error), float(floor)

    def state_dict(self) -> dict[str, Tensor]:
        """The potential, with which a resumed training need not fit again."""
        if self._phi is None or self._x1 is None:
            return {}
        state = {"phi": self._phi, "x1": self._x1, "errors": torch.tensor(self._errors)}
        return state if self._c is None else {**state, "c": self._c}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        if state:
            self._prepare(state["x1"], state.get("c"))
            self._phi = state["phi"]
            error, floor = state["errors"].tolist()
            self._errors = (error, floor)
            self._fitted_to = ()


def _sizes(total: int, largest: int) -> Iterator[int]:
    for done in range(0, total, largest):
        yield min(largest, total - done)


def _lowest(queries: Tensor, points: Tensor, height: Tensor) -> Tensor:
    """argmin_j height_j - 2 <query_i, point_j>, in blocks that stay in the processor's cache."""
    chosen = torch.zeros(len(queries), dtype=torch.long)
    lowest = torch.full((len(queries),), math.inf, dtype=queries.dtype)
    at_once = min(len(points), POINTS_AT_ONCE)
    for start in range(0, len(points), at_once):
        block = slice(start, start + at_once)
        for part in torch.arange(len(queries)).split(HEIGHTS_AT_ONCE // at_once):
            costs = torch.addmm(height[block], queries[part], points[block].T, alpha=-2)
            value, index = costs.min(dim=1)
            lower = value < lowest[part]
            lowest[part] = torch.where(lower, value, lowest[part])
            chosen[part] = torch.where(lower, index + start, chosen[part])
    return chosen
