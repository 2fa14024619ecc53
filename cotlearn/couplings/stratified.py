"""Stratified OT: one exact assignment per condition cluster and epoch."""

from __future__ import annotations

import copy
import itertools
import warnings
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import (
    OPTIONS,
    Coupling,
    Last,
    Match,
    Source,
    Traits,
    check_written,
    content_of,
    written,
)
from cotlearn.couplings.conditions import Clusters, KMeansCondition
from cotlearn.couplings.distances import pairing_cost, to_numpy
from cotlearn.validation import check_count, counted

Array = NDArray[Any]

FITTED_TO = "fitted_to"  #: name of the digest in a checkpoint
MANY = 128  #: rows from which it is said that conditions have few rows each
FEW = 8  #: rows of a condition on average, below which it is said
FEW_VALUES = 16  #: of a column of x1, which is then paired as it is
TINY = 4  #: rows up to which all permutations are tried, of all such clusters at once
UNBIASED = 0.9  #: of the variance of residuals: with less, the rest is left by a penalty
EXPLAINED, CERTAIN = 0.05, 4.0  #: share of the noise's variance, and deviations, for a warning
ROUNDED = 2  #: rounding errors of x1, up to which residuals are nothing else
LARGEST_SOLVE = 4096  #: most rows of an assignment, which then takes seconds and 0.3 GB


@dataclass(repr=False)
class StratifiedOT(Coupling):
    """Draws fresh noise for the whole data set and computes one exact plan per condition cluster.

    Each noise row has the N/K rows of its cluster as candidates, instead of the 1 + (B - 1)/K of a
    minibatch. Every data row is used once per epoch, and p(x0 | cluster) is exactly the prior.
    Inside a cluster x0 still depends on c: smaller clusters reduce this dependence, larger ones
    straighten more. This form of conditional OT is this project's own.

    A stream needs finite data (`.x1`, `.c` and `len`), or n_samples. A call on a batch makes its
    clusters of the rows of the batch alone, and says so once (UserWarning).

    Args:
        clusters: K, for k-means on the standardised conditions, fitted to the data of each stream,
            which keeps its own, and to the rows of each call; or a `KMeansCondition`,
            `PCAKMeansCondition` or `EmbeddedClusters`, which stays as it is if it comes fitted; or
            None, for one cluster per distinct condition.
        residual: pair x0 with the residuals of a linear regression of x1 on c in the cluster. Where
            x1 depends linearly on c inside a cluster, x0 then hardly does, and paths are
            straightened as much; a cluster needs more than twice as many rows as c has columns. A
            column of x1 with at most 16 values is paired as it is: the errors of slopes would sort
            equal values by c. They do so within narrow modes, which the first epoch warns of. The
            regression has a ridge penalty of 1 (c in units of its deviation). In a cluster of n
            rows where x1 leaves a line in c by less than 1/n of its spread, this penalty keeps the
            dependence, unless most rows lie in such clusters. Residuals change which rows are
            paired, not x1 itself.
        rows_per_solve: larger clusters are cut at random into parts of at most this many rows, from
            2 to 4,096.
        n_samples: rows of an epoch that are drawn anew each time, for endless data.

    Raises:
        TypeError: the data are endless and n_samples is None, or there is no condition.
        ValueError: there are more clusters than rows, or rows_per_solve is out of range.

    Warns (UserWarning) if k-means tells apart most columns of c, but hardly one of them; with
    residual, if in the first epoch c explains more than 5 % of a column of x0 inside the clusters,
    counted over all of them.
    """

    clusters: Any = None  # int | Clusters | None
    _: KW_ONLY
    residual: bool = False
    rows_per_solve: int = 1024
    n_samples: int | None = None

    name = "stratified"
    traits = Traits(needs_condition=True, whole_data=True)

    def __post_init__(self) -> None:
        given = self.clusters
        if given is not None and (not isinstance(given, Clusters) or given.own):
            # `dataclasses.replace` passes the clusters of the coupling that this one replaces
            self.clusters = KMeansCondition(
                given.clusters if isinstance(given, Clusters) else given
            )
            self.clusters.own = True
        if not isinstance(self.residual, bool):
            raise TypeError(f"residual must be True or False, got {self.residual!r}")
        self.name = "residual" if self.residual else self.name
        self._check_rows()
        if self.n_samples is not None:
            check_count(self.n_samples, "n_samples")
        self._last = self._shown = Last()  # `candidates` reads the second
        self._of_a_stream = self._warned = self._tested = False
        self._options = self.residual, repr(self.clusters)

    def _check_rows(self) -> None:
        check_count(self.rows_per_solve, "rows_per_solve", minimum=2, most=LARGEST_SOLVE)

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """Pair within the clusters of c; row i of the noise has the cluster of c_i."""
        self._check_rows()  # it may have been set since
        if not (self._of_a_stream or self._warned):
            self._warned = True
            warnings.warn(
                f"StratifiedOT was called with {counted(len(x0), 'row')}, of which it makes its "
                "clusters, not of a data set: if this is a batch, take batches from "
                "stream(Dataset(x1, c), batch_size=...), or use ConditionalOT",
                stacklevel=4,
            )
        if self._options != (now := (self.residual, repr(self.clusters))):
            self._options, self._last = now, Last()  # they were changed after a call
        self._shown = self._last
        label, paired = self._last(self._clustered, x1, c)
        target = np.arange(len(x0))
        tiny: dict[int, list[Array]] = defaultdict(list)
        for rows in self._solves(label, rng):
            if len(rows) <= TINY:
                tiny[len(rows)].append(rows)
                continue
            some = torch.from_numpy(rows)
            target[rows] = rows[exact_permutation(pairing_cost(x0[some], paired[some]))]
        for same_size in tiny.values():
            groups = np.array(same_size)
            target[groups] = _permuted(groups, to_numpy(x0), to_numpy(paired))
        if self.residual and not self._tested:
            self._tested = True
            clusters = _groups(np.arange(len(x0)), label[target])
            _warn_if_explained(to_numpy(x0), to_numpy(c)[target], clusters)
        return Match(np.arange(len(x0)), target)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Rows that were assigned together in the last epoch: a cluster or a part of it."""
        last = self._shown.value
        if last is None:
            return 1.0
        _, sizes = np.unique(last[0], return_counts=True)
        solved = sizes / np.ceil(sizes / self.rows_per_solve)
        return float(np.average(solved, weights=sizes))

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Fit the clusters to the training conditions; clusters that came fitted are kept."""
        if self.clusters is not None:
            _, c = self.draw(data, self.n_samples or 0, generator)
            if c is not None:  # else the first batch raises
                self._clusters_of(c)

    def prepared(
        self, data: Any, source: Source | None, generator: torch.Generator
    ) -> StratifiedOT:
        """A copy that keeps its clusters, whatever other streams and calls need."""
        self.prepare(data, source, generator)
        own = copy.copy(self)
        own._of_a_stream, own._tested, own._last = True, False, Last()
        self._shown = own._last
        return own

    def _clusters_of(self, c: Tensor) -> Clusters:
        """The clusters if they came fitted or were fitted to c (n, k), else a copy fitted to it."""
        clusters: Clusters = self.clusters
        came_fitted = clusters.state_dict() and not clusters.fitted_to
        content = content_of(c)
        if (embed := getattr(clusters, "_embedded", None)) is not None:
            content += content_of(embed(c[:64]))  # an encoder may have been trained since
        if came_fitted or clusters.fitted_to == content:
            return clusters
        clusters = copy.copy(clusters).fit(c)
        clusters.fitted_to = content
        if (inner := getattr(clusters, "inner", None)) is not None:
            inner.fitted_to = content
        self.clusters = clusters
        return clusters

    def epoch_rows(self, data: Any) -> int:
        """Rows that are paired at once: all the data, or n_samples."""
        if self.n_samples is None:
            self._check_finite(data)
        return self.n_samples or len(data)

    def draw(self, data: Any, n: int, generator: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """All the data, or n_samples fresh rows."""
        if self.n_samples is None:
            return data.x1, data.c
        return super().draw(data, n, generator)

    def _clustered(self, x1: Tensor, c: Tensor) -> tuple[Array, Tensor]:
        """The cluster of each row, (N,), and x1 or its residuals, (N, d)."""
        if self.clusters is None:
            label = torch.unique(c, dim=0, return_inverse=True)[1]
            if len(c) >= MANY and FEW * int(label.max() + 1) > len(c):
                warnings.warn(
                    f"clusters is None, and {int(label.max() + 1)} of {len(c)} conditions differ: "
                    "rows have few candidates, and those without an equal are paired at random; "
                    f"give a number of clusters: StratifiedOT({len(c) // 64}) has about 64 rows in "
                    "each",
                    stacklevel=6,
                )
        else:
            clusters = self.clusters if self._of_a_stream else self._clusters_of(c)
            label = clusters.labels(c)
        numbers = label.cpu().numpy()
        if not self.residual:
            return numbers, x1.clone()  # it is kept, and a buffer may be refilled
        values, conditions = to_numpy(x1), to_numpy(c)
        groups = _groups(np.arange(len(c)), numbers)
        left = _residuals(values, conditions, groups)
        rounding = torch.finfo(x1.dtype).eps * np.sqrt(np.square(values).mean(axis=0))
        left[:, np.sqrt(np.square(left).mean(axis=0)) <= ROUNDED * rounding] = 0.0
        few = _take_few_values(values, conditions)
        left[:, few] = values[:, few]
        return numbers, torch.from_numpy(left).to(x1)

    def _solves(self, label: Array, rng: np.random.Generator) -> Iterator[Array]:
        """The rows of each assignment: clusters, the large ones cut evenly at random."""
        order, alone = rng.permutation(len(label)), np.bincount(label)[label] == 1
        for rows in _groups(order[~alone[order]], label) if not alone.all() else ():
            if len(rows) <= self.rows_per_solve:
                yield rows
            else:
                yield from np.array_split(rows, -(-len(rows) // self.rows_per_solve))

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted clusters, and a digest of what they were fitted to."""
        if self.clusters is None:
            return {}
        state: dict[str, Tensor] = self.clusters.state_dict()
        if not self.clusters.fitted_to:
            return state
        fitted_to = torch.tensor(list(self.clusters.fitted_to), dtype=torch.uint8)
        return {**state, FITTED_TO: fitted_to, OPTIONS: written(self)}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned, of a coupling with the same options."""
        check_written(state, self)
        if self.clusters is not None and state:
            clusters, own = copy.copy(self.clusters), (FITTED_TO, OPTIONS)
            clusters.load_state_dict({k: v for k, v in state.items() if k not in own})
            clusters.fitted_to = bytes(state.get(FITTED_TO, torch.empty(0)).tolist())
            self.clusters, self._last = clusters, Last()


def _groups(rows: Array, label: Array) -> list[Array]:
    """The rows of each label, in the given order."""
    by_label = rows[np.argsort(label[rows], kind="stable")]
    return np.split(by_label, np.flatnonzero(np.diff(label[by_label])) + 1)


def _permuted(groups: Array, x0: Array, x1: Array) -> Array:
    """The rows of x1 (N, d) for the rows of x0 (N, d) in each of the groups (G, n), by trying all.

    The sum of squared distances is least where that of the inner products is greatest, and x1 may
    be shifted.
    """
    some = x1[groups]
    some = some - some.mean(axis=1, keepdims=True)
    alike = np.einsum("gid,gjd->gij", x0[groups], some)
    orders = np.array(list(itertools.permutations(range(groups.shape[1]))))
    gains = alike[:, np.arange(groups.shape[1]), orders].sum(axis=2)
    return np.take_along_axis(groups, orders[gains.argmax(axis=1)], axis=1)


def _take_few_values(y: Array, z: Array) -> Array:
    """Whether columns of y (N, d), (d,), have few values, most of them in rows with other z (N, k).

    With more values their distances are small against the errors of slopes, which do no harm then.
    """
    values = np.array([len(np.unique(column)) for column in y.T])
    found = (values <= FEW_VALUES) & (2 * values < len(y))
    for column in np.flatnonzero(found):  # rows that are equal as a whole do not count
        different = np.unique(np.column_stack([y[:, column], z]), axis=0)
        found[column] = 2 * values[column] < len(different)
    return found


def _warn_if_explained(noise: Array, c: Array, groups: list[Array]) -> None:
    """Warn if a regression of noise (N, d) on its conditions (N, k) explains some, by group."""
    before, after, free = np.zeros(noise.shape[1]), np.zeros(noise.shape[1]), 0
    for rows in groups:
        n, k = len(rows), c.shape[1]
        if n > 2 * (k + 1):
            _, left, _ = residuals(noise[rows], c[rows])
            before += noise[rows].var(axis=0) * n
            after += np.square(left).sum(axis=0) * (n - 1) / (n - k - 1)
            free += k
    if not free:
        return
    varies = before > 0  # else the column is padding
    share = np.where(varies, 1 - after / np.where(varies, before, 1.0), 0.0)
    chance = CERTAIN * (2 * free) ** 0.5 / len(noise)
    worst = int(share.argmax())
    if share[worst] > EXPLAINED + chance:
        warnings.warn(
            f"c explains {share[worst]:.0%} of column {worst} of the noise inside the clusters, "
            "although residual=True: x1 has narrow modes there, or clusters have too few rows; "
            "compare it with residual=False by linear_skew",
            stacklevel=6,
        )


def _residuals(y: Array, z: Array, groups: list[Array]) -> Array:
    """Residuals (N, d) of one linear regression of y (N, d) on z (N, k) for each group of rows.

    Where a column of y is all but linear in z, the penalty of the regression leaves a good part of
    its residuals, which depends on z. If that is so in most rows, the column has no penalty.
    """
    left, plain, biased = np.empty_like(y), np.empty_like(y), np.zeros(y.shape[1])
    for rows in groups:
        left[rows], plain[rows], columns = residuals(y[rows], z[rows])
        biased += len(rows) * columns
    return np.where(biased > len(y) / 2, plain, left)


def residuals(y: Array, z: Array) -> tuple[Array, Array, Array]:
    """Residuals of a linear regression of values y (n, d) on conditions z (n, k).

    The regression has an intercept, conditions scaled to unit variance, and a ridge penalty of 1,
    which is small if there are more rows than conditions and prevents an exact fit if there are
    fewer.

    Returns:
        The residuals, (n, d); those without a penalty, if there are more than twice as many rows as
        coefficients; the columns, (d,), in which their variance is clearly smaller.
    """
    rounding = 1e-12 * np.abs(z).max(axis=0)
    y, z = y - y.mean(axis=0), z - z.mean(axis=0)
    spread = z.std(axis=0)
    varies = spread > rounding
    z = z[:, varies] / spread[varies]
    n, k = z.shape
    none = np.zeros(y.shape[1], bool)
    if n <= k:
        left = np.linalg.solve(z @ z.T + np.eye(n), y)
        return left, left, none
    left = y - z @ np.linalg.solve(z.T @ z + np.eye(k), z.T @ y)
    if n <= 2 * (k + 1):
        return left, left, none
    plain = left - z @ np.linalg.lstsq(z, left)[0]
    before, after = (np.square(some).sum(axis=0) for some in (left, plain))
    return left, plain, after / (n - k - 1) < UNBIASED * before / n
