"""Conditional semidiscrete OT from continuous noise to the whole data set."""

from __future__ import annotations

import copy
import math
import warnings
from dataclasses import KW_ONLY, dataclass, replace
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import (
    OPTIONS,
    Coupling,
    Match,
    Pairs,
    Source,
    Traits,
    check_written,
    content_of,
    draw_noise,
    shuffled_noise,
    written,
)
from cotlearn.couplings.conditional import warn_if_imprecise
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.couplings.distances import distances
from cotlearn.couplings.unheeded import warn_if_one_column_rules
from cotlearn.progress import progress_bar
from cotlearn.randomness import Purpose, generator_for
from cotlearn.validation import check_condition, check_count, check_matrix, check_number

UNCONVERGED = 0.1  #: excess of the marginal error over its floor that causes a warning
DRAWS_PER_ROW = 200  #: noise rows that a fit draws for each data row
FEWEST_STEPS = 500  #: least number of steps of a fit, for small data sets
LARGEST_SEARCH = 1e11  #: most costs that a fit evaluates by default
FIRST_STEP, LAST_STEP = 0.05, 0.1  #: shares of the spread of costs and of neighbours' costs
HEIGHTS_AT_ONCE, POINTS_AT_ONCE = 300_000, 4096  #: block sizes that fit the processor's cache
OFFSET = 1000.0  #: deviations of x1 from 0 above which its mean is subtracted, else squares round
FAR_OFF = 3.0  #: deviations of x1 between its mean and the noise's from which the fit starts there
AVERAGED = 0.3  #: share of the steps, at the end, over which the potential is averaged


@dataclass(repr=False)
class SemidiscreteOT(Coupling):
    """Pairs (x0, c0) with data row argmin_j |x0 - x1_j|^2 + w |c0 - c_j|^2 - phi_j.

    The dual potential phi is fitted once, by averaged stochastic gradient ascent on the
    semidiscrete dual (Genevay 1605.08527): choosing a row more often than 1/N makes it costlier.
    Pairing is then a search over all the data, so that no batch limits the candidates. The
    condition term is this project's own: semidiscrete flow matching (2509.25519) has none.

    Length of the fit. From M draws no method can estimate the marginal better than to about
    0.4 sqrt(N/M), so the default is M = 200 N draws, but at most 1e11 cost evaluations (N/K for
    each draw; minutes). The step size falls geometrically from a share of the spread of all costs
    to a share of the costs between neighbouring rows: early draws must move a potential far, late
    draws not past its neighbours. The last 30 % of the steps are averaged.

    A stream needs finite data with `.x1`, `.c` and `len`. It searches the rows that it began with,
    if the data are refilled in place, too.

    Measured excess sqrt(marginal_error^2 - marginal_floor^2), with the CPU seconds of the fit:
    N = 1e3 in 2 to 32 dimensions .05 to .06 (1 s); the digits, 64 dimensions, .05 (4 s);
    N = 1e4 in 2 dimensions .06 to .07 (25 to 29 s); N = 2e4 in 2 clusters .09, in 64 clusters .06;
    N = 1e5 in 64 clusters, 2 dimensions .09 (6,400 steps of 10 ms each, or 20 ms in 32 dimensions).
    Larger N without clusters, or in many dimensions, was not measured.

    Args:
        condition_weight: w, at least 0. With 0, the default, and no clusters the condition does not
            count, and noise depends on it, as in `MinibatchOT`.
        clusters: K, or None. Noise and data are then paired only within their condition cluster (w
            still counts inside), and a search evaluates N/K rows instead of N.
        iterations: steps of the ascent, at least 1, each on N/32 noise rows (at least 64, at most
            4,096); if None, enough for 200 draws per data row.

    Attributes:
        marginal_error: total variation distance, in [0, 1], between the frequencies with which rows
            are chosen on fresh noise and the uniform 1/N; NaN before the fit.
        marginal_floor: the same distance for equally many draws from the uniform marginal.

    Raises:
        TypeError: the data are endless, or c is None but needed.
        ValueError: an option is out of range.
    """

    condition_weight: float = 0.0
    _: KW_ONLY
    clusters: int | None = None
    iterations: int | None = None

    name = "semidiscrete"
    traits = Traits(whole_data=True, transformable=False)

    def __post_init__(self) -> None:
        self.condition_weight = check_number(self.condition_weight, "condition_weight")
        for name in ("clusters", "iterations"):
            if getattr(self, name) is not None:
                check_count(getattr(self, name), name)
        if self.condition_weight or self.clusters:
            self.traits = replace(self.traits, needs_condition=True)
        self.marginal_error = self.marginal_floor = math.nan
        self._points: _Points | None = None  # the data that phi was fitted to
        self._source: tuple[bytes, ...] = ()  # what some noise of the fit holds, if it is known

    def fit(
        self,
        x1: Tensor,
        c: Tensor | None = None,
        *,
        source: Source | None = None,
        progress: bool | None = None,
    ) -> SemidiscreteOT:
        """Fit the potential to a data set.

        Args:
            x1: (N, d), the whole data set.
            c: (N, k), its conditions; may be None if w is 0 and there are no clusters.
            source: draws the noise; standard normal if None.
            progress: show a progress bar; if None, in terminals and notebooks.

        Returns:
            This coupling. It warns (RuntimeWarning) if the potential has not converged.
        """
        check_matrix(x1, "x1")
        self._check_condition(c, x1, "x1")
        self._fit(x1, c, source, progress)
        return self

    def _fit(
        self, x1: Tensor, c: Tensor | None, source: Source | None, progress: bool | None
    ) -> _Points:
        """The data with the fitted potential, which is kept as well."""
        points = _Points(self, x1, c)
        points.start_near(source)
        n = len(x1)
        iterations, batch_size = _effort([len(group) for group in points.groups])
        iterations = self.iterations or iterations
        few = min(1.0, n / batch_size)  # below 1 if a step chooses each row several times
        first, last = (few * step for step in self._steps(points, source))
        average = points.phi
        with progress_bar(total=iterations, what="potentials", show=progress) as bar:
            for step in range(iterations):
                rng = generator_for(0, step, Purpose.POTENTIAL)
                _, chosen = points.draw(batch_size, source, rng)
                rate = first * (last / first) ** (step / iterations)
                excess = batch_size / n - torch.bincount(chosen, minlength=n)
                points.phi = points.phi + rate * excess
                averaged = 1 + max(0, step - int((1 - AVERAGED) * iterations))
                average = average + (points.phi - average) / averaged
                bar.update()
        points.phi = average
        self._points, self._source = points, (_known(source, x1),)
        self.marginal_error, self.marginal_floor = self._marginal(points, source)
        if self.marginal_error > self.marginal_floor + UNCONVERGED:
            warnings.warn(
                f"the potential has not converged: marginal_error is {self.marginal_error:.2f} "
                f"(exact: {self.marginal_floor:.2f}); raise iterations above {iterations}, or "
                "bring x1 and the noise to like scales",
                RuntimeWarning,
                stacklevel=3,
            )
        return points

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Data rows in the cluster; with a condition weight, only those with near conditions."""
        if self._points is None:
            return 1.0
        sizes = torch.tensor([float(len(group)) for group in self._points.groups])
        rng, c = generator_for(0, 0, Purpose.NEIGHBOURS), self._points.scaled_c
        some = c[torch.randperm(len(c), generator=rng)[:512]]
        mean = distances(x0.double(), x1.double()).square().mean()
        near = distances(some, some).square() <= mean.cpu()
        return float((sizes**2).sum() / sizes.sum() * near.double().mean())

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Pair within the batch, to which the potential is fitted unless it was before.

        That fit takes standard normal noise, whatever x0 is: for other noise call `fit` first.

        Row i of the noise has the condition of row i. Rows can be chosen more than once: for
        training use `stream` with the whole data set.
        """
        rows, points = torch.arange(len(x0)), self._points
        if points is None or not points.are(self, x1, c):
            points = self._fit(x1, c, None, progress=False)
        found = points.search(x0.to(points.x1), rows)
        luck = torch.Generator().manual_seed(int(rng.integers(2**62)))
        return Match(rows.numpy(), points.spread(found, luck).numpy())

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Fit the potential unless it was fitted to these data and this noise."""
        self._check_finite(data)
        fitted = self._points is not None and self._points.are(self, data.x1, data.c)
        if not fitted or self._source not in ((), (_known(source, data.x1),)):
            self.fit(data.x1, data.c, source=source)

    def prepared(
        self, data: Any, source: Source | None, generator: torch.Generator
    ) -> SemidiscreteOT:
        """A copy that keeps its potential, whatever other streams and calls need."""
        own = copy.copy(self)
        own.prepare(data, source, generator)
        vars(self).update(vars(own))  # the last fit is kept here, too
        return own

    def solve(self, data: Any, n: int, source: Source | None, generator: torch.Generator) -> Pairs:
        """Draw noise, each row with the condition of a random data row, and pair it."""
        x0, chosen = cast(_Points, self._points).draw(n, source, generator)
        c = None if data.c is None else data.c[chosen]
        return Pairs(x0.to(data.x1.dtype), data.x1[chosen], c, torch.arange(n), chosen)

    def _steps(self, points: _Points, source: Source | None) -> tuple[float, float]:
        """First and last step size: how far one draw lowers the potential of the chosen row."""
        rng = generator_for(0, 0, Purpose.STEP_SIZE)
        x1 = points.x1[torch.randint(len(points.x1), (256,), generator=rng)]
        noise = draw_noise(x1, source, rng).double()
        cost = distances(noise, x1.double() - points.move).square()
        largest = float(points.scaled_c.square().sum(dim=1).max())
        warn_if_imprecise(float(cost.mean()), largest, 1, self.condition_weight)
        first = FIRST_STEP * float(cost.std())
        if not first > 0:
            return 1.0, 1.0  # all costs are equal: any step size will do
        x0 = draw_noise(points.x1, source, rng)
        last = LAST_STEP * math.prod(points.gap(x, rng) for x in (x0, points.x1))
        return first, min(max(last, 1e-6 * first), first) if math.isfinite(last) else first

    def _marginal(self, points: _Points, source: Source | None) -> tuple[float, float]:
        """Total variation distance to the uniform marginal, and its floor for as many draws."""
        n = len(points.x1)
        draws = min(max(20 * n, 20_000), 400_000)
        rng = generator_for(0, 0, Purpose.MARGINAL)
        counts = torch.zeros(n)
        for part in torch.arange(draws).split(4096):
            chosen = points.draw(len(part), source, rng)[1]
            counts += torch.bincount(chosen, minlength=n)
        exact = torch.bincount(torch.randint(n, (draws,), generator=rng), minlength=n)
        error, floor = ((k / draws - 1 / n).abs().sum() / 2 for k in (counts, exact))
        return float(error), float(floor)

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted potential and its data, so that resumed training need not fit again."""
        points = self._points
        if points is None:
            return {}
        errors = torch.tensor([self.marginal_error, self.marginal_floor])
        state = {"phi": points.phi, "x1": points.x1, "errors": errors, OPTIONS: written(self)}
        return {**state, "c": points.c} if points.c.numel() else state

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned, of a coupling with the same options.

        A potential holds for the noise that it was fitted to: stream with the same source.
        """
        check_written(state, self)
        if state:
            self._points = _Points(self, state["x1"], state.get("c"))
            self._points.phi, self._source = state["phi"], ()
            self.marginal_error, self.marginal_floor = state["errors"].tolist()


class _Points:
    """The data set in the form that is searched: rows (x1, sqrt(w) c) in float64, by cluster.

    Attributes:
        options: of the coupling, as it prints.
        x1: (N, d), float32, or float64 if it came so.
        c: (N, k), likewise; k = 0 without conditions.
        centre: (d,), subtracted from x1 and noise, which changes no distance; 0 if x1 is near 0.
        scaled_c: (N, k), sqrt(w) (c - mean of c), float64; k = 0 if w = 0.
        groups: the rows of each cluster.
        phi: (N,), the dual potential.
    """

    def __init__(self, coupling: SemidiscreteOT, x1: Tensor, c: Tensor | None) -> None:
        n, weight = len(x1), coupling.condition_weight
        self.options = repr(coupling)
        self.x1 = _kept(x1).clone()  # whose tensors may be refilled in place
        self.c = self.x1[:, :0] if c is None else _kept(check_condition(c)).clone()
        mean, deviation = self.x1.double().mean(dim=0), self.x1.double().std(dim=0, unbiased=False)
        self.centre = torch.where(mean.abs() > OFFSET * deviation, mean, 0.0)
        centred = (self.c - self.c.mean(dim=0)).double()
        self.scaled_c = math.sqrt(weight) * centred if weight else centred[:, :0]
        if weight:
            warn_if_one_column_rules(centred)
        self.phi, self.move = torch.zeros(n, dtype=torch.float64), torch.zeros(())
        self.label = torch.zeros(n, dtype=torch.long)
        if coupling.clusters is not None:
            self.label = KMeansCondition(coupling.clusters).fit(self.c).labels(self.c)
        order = self.label.argsort(stable=True)
        self.groups = list(order.split(torch.bincount(self.label).tolist()))
        rows = self.features(self.x1, torch.arange(n))
        self._rows = [rows[group] for group in self.groups]
        self._squares = [part.square().sum(dim=1) for part in self._rows]
        seen = torch.cat([self.x1, self.c], dim=1) if weight else self.x1
        self._copies = _copies(seen, self.label)

    def start_near(self, source: Source | None) -> None:
        """Begin at the potential that moves x1 to the noise, if it lies far off.

        A shift m of x1 changes costs by a number for each noise row and 2 m x1_j, so that it
        changes no optimal pairing.
        """
        rows = self.x1.double()
        noise = torch.zeros(())
        if source is not None:
            rng = generator_for(0, 1, Purpose.STEP_SIZE)
            noise = draw_noise(self.x1[:4096], source, rng).double().mean(dim=0)
        move = rows.mean(dim=0) - noise
        if move.norm() <= FAR_OFF * rows.var(dim=0, unbiased=False).sum().sqrt():
            return
        self.phi, self.move = 2 * (rows - rows.mean(dim=0)) @ move, move

    def spread(self, chosen: Tensor, rng: torch.Generator) -> Tensor:
        """The chosen rows (n,), each of equal rows as often: a search always finds the first."""
        if self._copies is None:
            return chosen
        kind, order, first, count = self._copies
        mine = kind[chosen]
        place = (torch.rand(len(chosen), generator=rng, dtype=torch.float64) * count[mine]).long()
        return order[first[mine] + place]

    def are(self, coupling: SemidiscreteOT, x1: Tensor, c: Tensor | None) -> bool:
        """Whether these are the points of x1 (N, d) and c (N, k), with these options."""
        if self.options != repr(coupling):
            return False
        c = x1[:, :0] if c is None else check_condition(c)
        same = zip((self.x1, self.c), (_kept(x1), _kept(c)), strict=True)
        return all(own.dtype == new.dtype and torch.equal(own, new) for own, new in same)

    def features(self, x: Tensor, own: Tensor) -> Tensor:
        """(x, sqrt(w) c[own]): its squared distance is the cost; float64, as w may be large."""
        return torch.cat([x.double() - self.centre, self.scaled_c[own]], dim=1)

    def draw(self, n: int, source: Source | None, rng: torch.Generator) -> tuple[Tensor, Tensor]:
        """Draw noise (n, d) with the conditions of random rows, and find its data rows (n,)."""
        own = torch.randint(len(self.x1), (n,), generator=rng)
        x0 = shuffled_noise(self.x1[own], source, rng)
        return x0, self.spread(self.search(x0, own), rng)

    def search(self, x0: Tensor, own: Tensor) -> Tensor:
        """The data row that each (x0, c[own]) is paired with, (n,)."""
        queries, label = self.features(x0, own), self.label[own]
        counts = torch.bincount(label, minlength=len(self.groups)).tolist()
        chosen = torch.empty(len(x0), dtype=torch.long)
        for k, rows in enumerate(label.argsort().split(counts)):
            group = self.groups[k]
            # |f - F_j|^2 - phi_j without |f|^2, which is the same for every j
            height = self._squares[k] - self.phi[group]
            chosen[rows] = group[_lowest(queries[rows], self._rows[k], height)]
        return chosen

    def gap(self, x: Tensor, rng: torch.Generator) -> float:
        """Median distance of about 256 rows (x, c) to the nearest other row of their cluster."""
        features, gaps = self.features(x, torch.arange(len(x))), []
        for group in self.groups:
            some = torch.randperm(len(group), generator=rng)[: 1 + 256 // len(self.groups)]
            distance = distances(features[group[some]], features[group])
            distance[distance <= 0] = math.inf  # the row itself and its duplicates
            gaps.append(distance.min(dim=1).values)
        return float(torch.cat(gaps).median())


def _known(source: Source | None, x1: Tensor) -> bytes:
    """What a source draws for a few rows, by which it is known; a source may change."""
    if source is None:
        return b""
    return content_of(draw_noise(x1[:64], source, torch.Generator().manual_seed(0)))


def _kept(x: Tensor) -> Tensor:
    """X on the CPU without its graph; float32, or float64 if it came so."""
    return x.detach().to("cpu", torch.promote_types(x.dtype, torch.float32))


def _copies(rows: Tensor, label: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor] | None:
    """Which rows (n, m) of a cluster are equal: kind of each row; rows by kind, first, number."""
    marked = torch.cat([rows.double(), label[:, None].double()], dim=1)
    _, kind, count = torch.unique(marked, dim=0, return_inverse=True, return_counts=True)
    if len(count) == len(rows):
        return None
    return kind, kind.argsort(stable=True), count.cumsum(0) - count, count


def _effort(sizes: list[int]) -> tuple[int, int]:
    """Default number of steps of a fit and noise rows per step, for clusters of these sizes."""
    n = sum(sizes)
    batch_size = min(max(n // 32, 64), 4096)
    searched = sum(size**2 for size in sizes) / n  # data rows that one draw evaluates, on average
    draws = max(DRAWS_PER_ROW * n, FEWEST_STEPS * batch_size)
    return math.ceil(min(draws, int(LARGEST_SEARCH / searched)) / batch_size), batch_size


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
