"""Stratified OT: one exact assignment per condition cluster and epoch."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import (
    Coupling,
    Match,
    Pairs,
    Sampler,
    Source,
    StreamOptions,
    draw_noise,
    generator_for,
    squared_distances,
    to_numpy,
)
from cotlearn.couplings.conditions import KMeansCondition, PCAKMeansCondition, Viewed
from cotlearn.validation import check_condition, check_count

Clusters = KMeansCondition | PCAKMeansCondition | Viewed
LARGEST_SOLVE = 4096  #: an exact assignment of so many rows takes seconds and 0.3 GB


class StratifiedOT(Coupling):
    """Fresh noise for the whole data set, split by condition cluster, one exact plan per cluster.

    Each noise row chooses among the N/K rows of its cluster instead of the 1 + (B - 1)/K of a
    minibatch, every row of the data is used once an epoch, and p(x0 | cluster) is exactly the
    prior. Inside a cluster x0 still depends on c: finer clusters leave less of that, larger ones
    straighten more. This project's own form of conditional OT.

    The data of a stream are finite (`.x1`, `.c` and `len`), or endless with n_samples.

    Args:
        clusters: K clusters by k-means on the standardised conditions, fitted anew to the data of
            each stream; a fitted or unfitted `KMeansCondition`, `PCAKMeansCondition` or `Viewed`;
            or None: one per distinct condition.
        residual: pair x0 with what a linear regression of x1 on c leaves over in the cluster. Where
            x1 follows c inside a cluster, x0 would follow it, too; the residual does not, and
            straightens as much. Which rows meet changes, x1 itself does not.
        rows_per_solve: larger clusters are cut at random into parts of at most this many rows.
        n_samples: rows of an epoch for endless samplers, drawn afresh each epoch.
        seed: of k-means++.

    Raises:
        TypeError: the data are endless and n_samples is None, or there is no condition.
        ValueError: more clusters than rows.
    """

    name = "stratified"
    needs_condition = True
    whole_data = True

    def __init__(
        self,
        clusters: int | Clusters | None = None,
        *,
        residual: bool = False,
        rows_per_solve: int = 1024,
        n_samples: int | None = None,
        seed: int = 0,
    ) -> None:
        self._refit = clusters is not None and not isinstance(clusters, Clusters)
        if clusters is not None and not isinstance(clusters, Clusters):
            clusters = KMeansCondition(check_count(clusters, "clusters"), seed=seed)
        self.clusters = clusters
        self.residual = residual
        self.rows_per_solve = check_count(rows_per_solve, "rows_per_solve", minimum=2)
        if self.rows_per_solve > LARGEST_SOLVE:
            raise ValueError(f"rows_per_solve must be at most {LARGEST_SOLVE}: {rows_per_solve}")
        self.n_samples = None if n_samples is None else check_count(n_samples, "n_samples")
        self._labels: tuple[Tensor, NDArray[np.int64]] | None = None
        self._left: tuple[Tensor, Tensor, Tensor] | None = None

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """Pair within the clusters of c; row i of the noise has the cluster of c_i."""
        assert c is not None
        label = self._label(check_condition(c))
        meant = self._residuals(x1, c, label) if self.residual else x1
        target = np.empty(len(x0), dtype=np.int64)
        for rows in self._solves(label, rng):
            cost = squared_distances(x0[torch.from_numpy(rows)], meant[torch.from_numpy(rows)])
            target[rows] = rows[exact_permutation(cost)]
        return Match(np.arange(len(x0)), target)

    def candidates(self, x0: Tensor, x1: Tensor, c: Tensor | None = None) -> float:
        """Rows of the cluster, or of its part that is solved at once, in the last epoch paired."""
        if self._labels is None:
            return 1.0
        sizes = np.bincount(self._labels[1])
        sizes = sizes[sizes > 0]
        solved = sizes / np.ceil(sizes / self.rows_per_solve)
        return float((sizes * solved).sum() / sizes.sum())

    def batches(self, data: Any, options: StreamOptions) -> Iterator[Pairs]:
        """Batches of epochs that are paired whole; an incomplete last batch is left out.

        Where the data have fewer rows than a batch, epochs are put together.
        """
        size = self._size(data)
        epochs = -(-options.batch_size // size)  # more than one only where the data are small
        batches = epochs * size // options.batch_size
        self._fit(data, options.seed)
        number, first = divmod(options.start, batches)
        while True:
            parts = [
                self._epoch(data, options.source, generator_for(options.seed, number * epochs + k))
                for k in range(epochs)
            ]
            rng = generator_for(options.seed, number, purpose=2)
            order = torch.randperm(epochs * size, generator=rng)
            joined = parts[0] if epochs == 1 else _concatenate(parts)
            for k in range(first, batches):
                rows = order[k * options.batch_size : (k + 1) * options.batch_size]
                yield joined.map(lambda value, rows=rows: value[rows])  # type: ignore[misc]
            number, first = number + 1, 0

    def epoch_rows(self, data: Sampler) -> int:
        """Rows that are paired at once: the data set, or n_samples."""
        return self._size(data)

    def _epoch(self, data: Any, source: Source | None, rng: torch.Generator) -> Pairs:
        """Fresh noise for every row of the data, paired."""
        x1, c = data.sample(self.n_samples, generator=rng) if self.n_samples else (data.x1, data.c)
        return self(draw_noise(x1, source, rng), x1, c, generator=rng)

    def _size(self, data: Any) -> int:
        if self.n_samples is not None:
            return self.n_samples
        if not all(hasattr(data, name) for name in ("x1", "c", "__len__")):
            raise TypeError(
                f"{type(self).__name__} pairs whole epochs, but these data are endless (they have "
                "no x1, c and len): give n_samples=, the rows of an epoch"
            )
        return len(data)

    def _fit(self, data: Any, seed: int) -> None:
        """Fit the clusters on the training conditions; those that came fitted are kept."""
        if self.clusters is None or (self.clusters.state_dict() and not self._refit):
            return
        if self.n_samples is None:
            c = data.c
        else:
            _, c = data.sample(self.n_samples, generator=generator_for(seed, 0, purpose=3))
        if c is None:
            raise TypeError(f"{type(self).__name__} needs the conditions c of x1, got None")
        self.clusters.fit(c)
        self._labels = self._left = None

    def _label(self, c: Tensor) -> NDArray[np.int64]:
        if self._labels is not None and self._labels[0] is c:
            return self._labels[1]  # the same data set, epoch after epoch
        if self.clusters is None:
            label = torch.unique(c, dim=0, return_inverse=True)[1]
        else:
            if not self.clusters.state_dict():
                self.clusters.fit(c)
            label = self.clusters.labels(c)
        numbers: NDArray[np.int64] = label.cpu().numpy().astype(np.int64)
        self._labels = (c, numbers)
        return numbers

    def _residuals(self, x1: Tensor, c: Tensor, label: NDArray[np.int64]) -> Tensor:
        """What the conditions leave over of x1 in each cluster, (N, d)."""
        if self._left is not None and self._left[0] is x1 and self._left[1] is c:
            return self._left[2]
        values, conditions = to_numpy(x1), to_numpy(c)
        left = np.empty_like(values)
        for rows in _groups(np.argsort(label, kind="stable"), label):
            left[rows] = _unexplained(values[rows], conditions[rows])
        self._left = (x1, c, torch.from_numpy(left).to(x1))
        return self._left[2]

    def _solves(
        self, label: NDArray[np.int64], rng: np.random.Generator
    ) -> Iterator[NDArray[np.int64]]:
        """The rows of each assignment: clusters, the large ones cut up evenly at random."""
        shuffled = rng.permutation(len(label))
        by_label = shuffled[np.argsort(label[shuffled], kind="stable")]
        for rows in _groups(by_label, label):
            yield from np.array_split(rows, -(-len(rows) // self.rows_per_solve))

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted clusters."""
        return {} if self.clusters is None else self.clusters.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        if self.clusters is not None and state:
            self.clusters.load_state_dict(state)
            self._labels, self._left, self._refit = None, None, False


def _groups(ordered: NDArray[np.int64], label: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Rows that are ordered by label, cut where the label changes."""
    return np.split(ordered, np.flatnonzero(np.diff(label[ordered])) + 1)


def _unexplained(values: NDArray[Any], conditions: NDArray[Any]) -> NDArray[np.float64]:
    """Residuals (n, d) of a linear regression of values (n, d) on conditions (n, k).

    With an intercept, each condition scaled to unit variance, and a ridge of 1, which is little
    for more rows than conditions and holds fewer rows back from being explained away.
    """
    y = values.astype(np.float64) - values.mean(axis=0, dtype=np.float64)
    z = conditions.astype(np.float64) - conditions.mean(axis=0, dtype=np.float64)
    spread = z.std(axis=0)
    z = z[:, spread > 1e-12] / spread[spread > 1e-12]
    n, k = z.shape
    if n <= k:
        dual: NDArray[np.float64] = np.linalg.solve(z @ z.T + np.eye(n), y)
        return dual
    residual: NDArray[np.float64] = y - z @ np.linalg.solve(z.T @ z + np.eye(k), z.T @ y)
    return residual


def _concatenate(parts: list[Pairs]) -> Pairs:
    """Several Pairs as one."""

    def joined(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        return None if values[0] is None else torch.cat(values)

    return Pairs(*(joined(n) for n in ("x0", "x1", "c", "source_index", "target_index", "weight")))
