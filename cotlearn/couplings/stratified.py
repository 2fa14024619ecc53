"""Stratified OT: one exact assignment per condition cluster and epoch."""

import warnings
from collections.abc import Iterator
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import Coupling, Last, Match, Source, squared_distances, to_numpy
from cotlearn.couplings.conditions import Clusters, KMeansCondition
from cotlearn.validation import check_count

Array = NDArray[Any]

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
        clusters: K, for k-means on the standardised conditions, fitted anew to the data of each
            stream; or a `KMeansCondition`, `PCAKMeansCondition` or `EmbeddedClusters`, fitted or
            not; or None, for one cluster per distinct condition.
        residual: pair x0 with the residuals of a linear regression of x1 on c in the cluster. Where
            x1 depends linearly on c inside a cluster, x0 then does not, and paths are straightened
            as much. This changes which rows are paired, not x1 itself.
        rows_per_solve: larger clusters are cut at random into parts of at most this many rows, from
            2 to 4,096.
        n_samples: rows of an epoch that are drawn anew each time, for endless data.

    Raises:
        TypeError: the data are endless and n_samples is None, or there is no condition.
        ValueError: there are more clusters than rows, or rows_per_solve is out of range.
    """

    clusters: Any = None  # int | Clusters | None
    _: KW_ONLY
    residual: bool = False
    rows_per_solve: int = 1024
    n_samples: int | None = None

    name = "stratified"
    needs_condition = True
    whole_data = True

    def __post_init__(self) -> None:
        self._refit = self.clusters is not None and not isinstance(self.clusters, Clusters)
        if self._refit:
            self.clusters = KMeansCondition(self.clusters)
        if not isinstance(self.residual, bool):
            raise TypeError(f"residual must be True or False, got {self.residual!r}")
        self.name = "residual" if self.residual else self.name
        check_count(self.rows_per_solve, "rows_per_solve", minimum=2, most=LARGEST_SOLVE)
        if self.n_samples is not None:
            check_count(self.n_samples, "n_samples")
        self._last, self._streams = Last(), False

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """Pair within the clusters of c; row i of the noise has the cluster of c_i."""
        if not self._streams:
            self._streams = True
            warnings.warn(
                f"StratifiedOT was called with {len(x0)} rows: its clusters are theirs, not those "
                "of a data set; if this is a batch, take batches from stream(Dataset(x1, c), "
                "batch_size=...), or use ConditionalOT",
                stacklevel=3,
            )
        label, paired = self._last(self._clustered, x1, c)
        target = np.empty(len(x0), dtype=np.int64)
        for rows in self._solves(label, rng):
            some = torch.from_numpy(rows)
            target[rows] = rows[exact_permutation(squared_distances(x0[some], paired[some]))]
        return Match(np.arange(len(x0)), target)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Rows that were assigned together in the last epoch: a cluster or a part of it."""
        if self._last.value is None:
            return 1.0
        _, sizes = np.unique(self._last.value[0], return_counts=True)
        solved = sizes / np.ceil(sizes / self.rows_per_solve)
        return float(np.average(solved, weights=sizes))

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Fit the clusters to the training conditions; clusters that came fitted are kept."""
        if self.clusters is None or (self.clusters.state_dict() and not self._refit):
            return
        _, c = self.draw(data, self.n_samples or 0, generator)
        if c is not None:  # else the first batch raises
            self.clusters.fit(c)
            self._last = Last()

    def epoch_rows(self, data: Any) -> int:
        """Rows that are paired at once: all the data, or n_samples."""
        self._streams = True
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
        else:
            if not self.clusters.state_dict():
                self.clusters.fit(c)
            label = self.clusters.labels(c)
        numbers = label.cpu().numpy()
        if not self.residual:
            return numbers, x1
        values, conditions = to_numpy(x1), to_numpy(c)
        left = np.empty_like(values)
        for rows in _groups(np.arange(len(c)), numbers):
            left[rows] = residuals(values[rows], conditions[rows])
        return numbers, torch.from_numpy(left).to(x1)

    def _solves(self, label: Array, rng: np.random.Generator) -> Iterator[Array]:
        """The rows of each assignment: clusters, the large ones cut evenly at random."""
        for rows in _groups(rng.permutation(len(label)), label):
            yield from np.array_split(rows, -(-len(rows) // self.rows_per_solve))

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted clusters."""
        return {} if self.clusters is None else self.clusters.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned."""
        if self.clusters is not None and state:
            self.clusters.load_state_dict(state)
            self._refit, self._last = False, Last()


def _groups(rows: Array, label: Array) -> list[Array]:
    """The rows of each label, in the given order."""
    by_label = rows[np.argsort(label[rows], kind="stable")]
    return np.split(by_label, np.flatnonzero(np.diff(label[by_label])) + 1)


def residuals(y: Array, z: Array) -> Array:
    """Residuals (n, d) of a linear regression of values y (n, d) on conditions z (n, k).

    The regression has an intercept, conditions scaled to unit variance, and a ridge penalty of 1,
    which is small if there are more rows than conditions and prevents an exact fit if there are
    fewer.
    """
    y, z = y - y.mean(axis=0), z - z.mean(axis=0)
    spread = z.std(axis=0)
    z = z[:, spread > 1e-12] / spread[spread > 1e-12]
    n, k = z.shape
    if n <= k:
        return np.linalg.solve(z @ z.T + np.eye(n), y)
    return y - z @ np.linalg.solve(z.T @ z + np.eye(k), z.T @ y)
