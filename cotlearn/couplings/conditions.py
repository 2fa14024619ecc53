"""What a condition is when pairs are made: standardised, clustered, projected, put together.

The network is always given the condition itself; these functions decide what the *coupling* sees.
Each is fitted once, on the training set, keeps what it fitted, and is called as f(c) -> (n, m).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings.base import WithOptions, to_numpy
from cotlearn.datasets import Standardiser
from cotlearn.renamed import renamed
from cotlearn.validation import (
    check_condition,
    check_count,
    check_matrix,
    check_number,
    check_same_rows,
)

ROWS_AT_ONCE = 4096  #: embedded rows, or distances, that are held in memory together


def combine(conditions: Mapping[str, Tensor], weights: Mapping[str, float] | None = None) -> Tensor:
    """Several named conditions as one: each standardised, then weighted.

    The squared distance of the result is sum_name w_name |difference|^2 / columns, on average 2
    for each condition of weight 1, whatever its scale and its number of columns (constant columns
    do not count).

    Args:
        conditions: name -> (n, k_name).
        weights: name -> weight, at least 0; 1 where not given.
    """
    if not conditions:
        raise ValueError("conditions is empty: give at least one named condition")
    weights = {} if weights is None else weights
    unknown = sorted(set(weights) - set(conditions))
    if unknown:
        raise ValueError(f"weights names {unknown}, conditions has {sorted(conditions)}")
    parts: list[Tensor] = []
    first_name, first = next(iter(conditions.items()))
    for name, c in conditions.items():
        c = check_condition(c, name)
        check_same_rows(c, name, first, first_name)
        weight = check_number(weights.get(name, 1.0), f"weights[{name!r}]")
        scaler = Standardiser.fit(c)
        varying = max(1, int((scaler.std > 0).sum()))
        parts.append(scaler(c) * math.sqrt(weight / varying))
    return torch.cat(parts, dim=1)


class Clusters(WithOptions):
    """Conditions grouped by the nearest of some centroids: an abstract class.

    Called on c (n, k) it returns the centroids (n, m) that stand for the rows; `labels(c)` returns
    their numbers. One that `project`s before the search overrides `_fit` and `project`.
    """

    clusters: int
    seed: int = 0
    _fitted: Mapping[str, Tensor] = {}

    def __post_init__(self) -> None:
        check_count(self.clusters, "clusters")
        check_count(self.seed, "seed", minimum=0)

    def fit(self, c: Tensor) -> Self:
        """Find the centroids of the training conditions c (n, k).

        Raises:
            ValueError: there are more clusters than rows.
        """
        c = check_condition(c)
        if self.clusters > len(c):
            raise ValueError(f"clusters must be at most the {len(c)} rows of c: {self.clusters}")
        self._fitted = self._fit(c)
        centroids = _k_means(to_numpy(self.project(c)), self.clusters, self.seed)
        self._fitted = {**self._fitted, "centroids": torch.from_numpy(centroids).to(c)}
        return self

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        """What `project` needs."""
        raise NotImplementedError

    def project(self, c: Tensor) -> Tensor:
        """The space of the centroids, (n, m)."""
        raise NotImplementedError

    @property
    def centroids(self) -> Tensor:
        """(K, m), in the space of `project`."""
        return self._ready("centroids")

    def labels(self, c: Tensor) -> Tensor:
        """The number of the nearest centroid, (n,), 0 .. K-1; in float64, as some lie close."""
        centroids = self.centroids.to(c.device, torch.float64)
        parts = (self.project(part).double() for part in check_condition(c).split(ROWS_AT_ONCE))
        return torch.cat([torch.cdist(part, centroids).argmin(dim=1) for part in parts])

    def __call__(self, c: Tensor) -> Tensor:
        """The centroid of each row, (n, m)."""
        return self.centroids.to(c.device)[self.labels(c)]

    def state_dict(self) -> dict[str, Tensor]:
        """What was fitted, to be saved with the weights."""
        return dict(self._fitted)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        self._fitted = dict(state)

    def _ready(self, name: str) -> Tensor:
        if not self._fitted:
            raise ValueError(f"{self!r} is not fitted: call fit(c) on the training conditions")
        return self._fitted[name]


@dataclass(repr=False)
class KMeansCondition(Clusters):
    """The nearest of K centroids, fitted by k-means++ on standardised conditions.

    Centroids are (K, k), in standardised units.

    Args:
        clusters: K, at least 1. Where the data have fewer distinct conditions, each gets its own.
        seed: of k-means++.
    """

    clusters: int = 64
    _: KW_ONLY
    seed: int = 0

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        scaler = Standardiser.fit(c)
        return {"mean": scaler.mean, "std": scaler.std}

    def project(self, c: Tensor) -> Tensor:
        """The conditions (n, k) in standard units."""
        mean, std = (self._ready(name).to(c.device) for name in ("mean", "std"))
        return Standardiser(mean, std)(check_matrix(check_condition(c), "c", columns=len(mean)))


@dataclass(repr=False, kw_only=True)
class PCAKMeansCondition(Clusters):
    """COT Policy's condition for images (2505.01179): PCA of raw pixels, then k-means.

    Pixels are flattened, centred by the mean of the training set (stored: the published code
    centres each batch by its own mean), projected to principal components; proprioception is
    appended unscaled; the nearest of K centroids stands for the row.

    The condition is one matrix whose first columns are the flattened pixels.

    Args:
        pixels: columns of c that are pixels; all if None.
        components: principal components, at most the number of training rows and of pixels.
        clusters: K.
    """

    pixels: int | None = None
    components: int = 100
    clusters: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        check_count(self.components, "components")
        if self.pixels is not None:
            check_count(self.pixels, "pixels")

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        pixels = c[:, : self.pixels]
        if self.pixels not in (None, pixels.shape[1]):
            raise ValueError(f"pixels is {self.pixels}, but c has only {c.shape[1]} columns")
        if self.components > (most := min(pixels.shape)):
            raise ValueError(f"components must be at most {most} for this c, got {self.components}")
        from sklearn.decomposition import PCA  # late: it takes a second

        pca = PCA(self.components, random_state=self.seed).fit(to_numpy(pixels))
        fitted = {"mean": pca.mean_, "basis": pca.components_}
        return {name: torch.from_numpy(value).to(c) for name, value in fitted.items()}

    def project(self, c: Tensor) -> Tensor:
        """Principal components and proprioception, (n, components + other columns)."""
        c = check_condition(c)
        mean, basis = (self._ready(name).to(c) for name in ("mean", "basis"))
        pixels = check_matrix(c[:, : self.pixels], "the pixels of c", columns=len(mean))
        return torch.cat([(pixels - mean) @ basis.T, c[:, len(mean) :]], dim=1)


@dataclass(repr=False)
class EmbeddedClusters(Clusters):
    """Clusters of what a function makes of the conditions: of pictures, of an encoder's features.

    Args:
        embed: makes a matrix (n, m) of conditions (n, k); stays as it is.
        inner: clusters that are fitted to the embedding.
        rows: at most so many of the training conditions, drawn at random, are embedded for that.
    """

    embed: Callable[[Tensor], Tensor]
    inner: Clusters
    _: KW_ONLY
    rows: int = 20_000

    def __post_init__(self) -> None:
        if not callable(self.embed):
            raise TypeError(f"embed must be a function of c, got {self.embed!r}")
        check_count(self.rows, "rows")

    def fit(self, c: Tensor) -> Self:
        """Fit the clusters to the embedding of c (n, k)."""
        c = check_condition(c)
        if len(c) > self.rows:
            rng = torch.Generator().manual_seed(self.seed)
            c = c[torch.randperm(len(c), generator=rng)[: self.rows].to(c.device)]
        self.inner.fit(self._embedded(c))
        return self

    def project(self, c: Tensor) -> Tensor:
        """The embedding in the space of the centroids, (n, m)."""
        return self.inner.project(self._embedded(c))

    @property
    def centroids(self) -> Tensor:
        """(K, m), of the clusters of the embedding."""
        return self.inner.centroids

    def state_dict(self) -> dict[str, Tensor]:
        """What the clusters of the embedding fitted."""
        return self.inner.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        self.inner.load_state_dict(state)

    def _embedded(self, c: Tensor) -> Tensor:
        with torch.no_grad():
            return check_condition(self.embed(c), "embed(c)")


def _k_means(rows: Any, clusters: int, seed: int) -> Any:
    """The distinct rows if these are few; else centroids by k-means++, of very many on a sample."""
    distinct = np.unique(rows, axis=0)
    if len(distinct) <= clusters:
        return distinct
    rng = np.random.default_rng(seed)
    most = max(50_000, 16 * clusters)
    if len(rows) > most:
        rows = rows[rng.choice(len(rows), most, replace=False)]
    from sklearn.cluster import KMeans  # late: it takes a second

    return KMeans(clusters, n_init=1, random_state=seed).fit(rows).cluster_centers_


__getattr__ = renamed(__name__, {"Viewed": "EmbeddedClusters"})
