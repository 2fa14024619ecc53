"""Batches of few strata: for losses that compare rows of near conditions with each other."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import torch

from cotlearn.couplings.base import Pairs, Source, Traits, shuffled_noise
from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.couplings.independent import Independent
from cotlearn.validation import check_count, check_has


@dataclass(repr=False)
class StratifiedBatches(Independent):
    """Independent pairs, in batches with many rows of a few strata of near conditions.

    The strata are k-means clusters of the conditions, of `rows` rows on average. A batch consists
    of groups of `rows` rows, each of one stratum, drawn with a probability proportional to its
    size; the pairs say which row is of which `group`. Within a group, rows are drawn without
    replacement until all of the stratum have been drawn. So every data row is as likely as in
    `Independent`, and noise does not depend on the condition; but the rows of a batch are not
    independent.

    A stream needs finite data (`.x1`, `.c` and `len`), and keeps the strata that it began with, if
    the data are refilled in place, too. A call on a batch makes no groups.

    Args:
        rows: of a group, and of a stratum on average, at least 2.
        clusters: strata to take in the place of these, for instance of pictures: fitted
            `EmbeddedClusters`.

    Raises:
        TypeError: the data are endless, or have no condition.
    """

    rows: int = 64
    clusters: Any = None  # Clusters | None, see couplings.conditions

    name = "stratified_batches"
    traits = Traits(needs_condition=True, whole_data=True, solves=False, transformable=False)

    def __post_init__(self) -> None:
        check_count(self.rows, "rows", minimum=2)
        if self.clusters is not None:
            check_has(self.clusters, "clusters", "fitted clusters", "labels")
        self._strata: tuple[torch.Tensor, ...] = ()
        self._label = torch.zeros(0, dtype=torch.long)

    def prepare(self, data: Any, source: Source | None, generator: torch.Generator) -> None:
        """Find the strata of the data, as they are when the stream begins."""
        self._check_finite(data)
        self._check_condition(data.c, data.x1, "x1 of the data")
        clusters = self.clusters
        if clusters is None:
            clusters = KMeansCondition(max(1, len(data) // self.rows)).fit(data.c)
        label = clusters.labels(data.c).cpu()
        found = torch.unique(label, return_inverse=True, return_counts=True)
        self._label, sizes = found[1], found[2]
        self._strata = self._label.argsort(stable=True).split(sizes.tolist())

    def prepared(
        self, data: Any, source: Source | None, generator: torch.Generator
    ) -> StratifiedBatches:
        """A copy that keeps its strata, whatever other streams need."""
        own = copy.copy(self)
        own.prepare(data, source, generator)
        return own

    def solve(self, data: Any, n: int, source: Source | None, generator: torch.Generator) -> Pairs:
        """Draw n rows from strata, the last one's group cut where n is no multiple of `rows`."""
        groups = -(-n // self.rows)
        of = torch.randint(len(data), (groups,), generator=generator)  # so by size
        drawn = []
        for stratum in self._label[of].tolist():
            members = self._strata[stratum]
            order = torch.randperm(len(members), generator=generator)
            drawn.append(members[order[torch.arange(self.rows) % len(members)]])
        index = torch.cat(drawn)[:n]
        group = torch.arange(groups).repeat_interleave(self.rows)[:n]
        x1, c = self._rows_of(data, index)
        x0 = shuffled_noise(x1, source, generator)
        return Pairs(x0, x1, c, torch.arange(n), index, group=group)
