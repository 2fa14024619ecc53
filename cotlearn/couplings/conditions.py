"""What a condition is when pairs are made: standardised, clustered, projected, put together.

The network is always given the condition itself; these functions decide what the *coupling* sees.
Each is fitted once, on the training set, keeps what it fitted, and is called as f(c) -> (n, m).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any, Self

import numpy as np
import torch
from sklearn.cluster import KMeans
from sklearn.decomposition import PCA
from sklearn.exceptions import ConvergenceWarning
from torch import Tensor

from cotlearn.couplings.base import to_numpy
from cotlearn.validation import check_condition, check_count, check_number, check_same_rows

_VIEWED_AT_ONCE = 4096  #: rows of pictures that are held in memory together


def standardise(c: Tensor, *, reference: Tensor | None = None) -> Tensor:
    """Columns of c with mean 0 and standard deviation 1; constant columns become 0.

    Args:
        c: (n, k).
        reference: (m, k) the rows that mean and standard deviation are taken from; c if None.
    """
    c = check_condition(c)
    reference = c if reference is None else check_condition(reference, "reference")
    if reference.shape[1] != c.shape[1]:
        raise ValueError(f"reference has {reference.shape[1]} columns, c has {c.shape[1]}")
    return _scaled(c, *_mean_and_std(reference))


def combine(conditions: Mapping[str, Tensor], weights: Mapping[str, float] | None = None) -> Tensor:
    """Several named conditions as one: each standardised, then weighed.

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
    parts = []
    first_name, first = next(iter(conditions.items()))
    for name, c in conditions.items():
        check_same_rows(check_condition(c, name), name, first, first_name)
        weight = check_number(weights.get(name, 1.0), f"weights[{name!r}]")
        varying = max(1, int((c != c[0]).any(dim=0).sum()))
        parts.append(standardise(c) * math.sqrt(weight / varying))
    return torch.cat(parts, dim=1)


class KMeansCondition:
    """The nearest of K centroids, fitted by k-means++ on standardised conditions.

    Called on c of shape (n, k) it returns the centroids (n, k) that stand for the rows, in
    standardised units; `labels(c)` returns their numbers.

    Args:
        clusters: K, at least 1. Where the data have fewer distinct conditions, each gets its own.
        seed: of k-means++.
    """

    def __init__(self, clusters: int = 64, *, seed: int = 0) -> None:
        self.clusters = check_count(clusters, "clusters")
        self.seed = check_count(seed, "seed", minimum=0)
        self._fitted: dict[str, Tensor] = {}

    def fit(self, c: Tensor) -> Self:
        """Find the centroids of c (n, k).

        Raises:
            ValueError: there are more clusters than rows.
        """
        c = check_condition(c)
        if self.clusters > len(c):
            raise ValueError(f"clusters must be at most the {len(c)} rows of c: {self.clusters}")
        mean, std = _mean_and_std(c)
        scaled = to_numpy(_scaled(c, mean, std))
        distinct = np.unique(scaled, axis=0)
        if len(distinct) <= self.clusters:
            centroids = distinct
        else:
            centroids = _k_means(scaled, self.clusters, self.seed)
        self._fitted = {"mean": mean, "std": std, "centroids": torch.from_numpy(centroids).to(c)}
        return self

    @property
    def centroids(self) -> Tensor:
        """(K, k), in standardised units."""
        if not self._fitted:
            raise ValueError(f"{self!r} is not fitted: call fit(c) on the training conditions")
        return self._fitted["centroids"]

    def labels(self, c: Tensor) -> Tensor:
        """The number of the nearest centroid, (n,), 0 .. K-1."""
        c = check_condition(c)
        centroids = self.centroids.to(c.device)
        mean, std = self._fitted["mean"].to(c.device), self._fitted["std"].to(c.device)
        if c.shape[1] != len(mean):
            raise ValueError(f"c has {c.shape[1]} columns, this was fitted on {len(mean)}")
        return _nearest(_scaled(c, mean, std), centroids)

    def __call__(self, c: Tensor) -> Tensor:
        """The centroid of each row, (n, k)."""
        return self.centroids.to(c.device)[self.labels(c)]

    def state_dict(self) -> dict[str, Tensor]:
        """What was fitted, to be saved with the weights."""
        return dict(self._fitted)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        self._fitted = dict(state)

    def __repr__(self) -> str:
        return f"KMeansCondition(clusters={self.clusters}, seed={self.seed})"


class PCAKMeansCondition:
    """COT Policy's condition for images (2505.01179): PCA of raw pixels, then k-means.

    Pixels are flattened, centred by the mean of the training set (stored: the published code
    centres each batch by its own mean), projected to principal components; proprioception is
    appended unscaled; the nearest of K centroids stands for the row.

    The condition is one matrix whose first columns are the flattened pixels.

    Args:
        pixels: columns of c that are pixels; all if None.
        components: principal components, at most the number of training rows and of pixels.
        clusters: K.
        seed: of PCA and k-means++.
    """

    def __init__(
        self,
        *,
        pixels: int | None = None,
        components: int = 100,
        clusters: int = 64,
        seed: int = 0,
    ) -> None:
        self.pixels = None if pixels is None else check_count(pixels, "pixels")
        self.components = check_count(components, "components")
        self.clusters = check_count(clusters, "clusters")
        self.seed = check_count(seed, "seed", minimum=0)
        self._fitted: dict[str, Tensor] = {}

    def fit(self, c: Tensor) -> Self:
        """Fit mean, components and centroids on the training conditions (n, k)."""
        c = check_condition(c)
        pixels, _ = self._split(c)
        for name, limit in (("components", min(pixels.shape)), ("clusters", len(c))):
            if getattr(self, name) > limit:
                raise ValueError(
                    f"{name} must be at most {limit} for c of shape {tuple(c.shape)}, got "
                    f"{getattr(self, name)}"
                )
        pca = PCA(self.components, svd_solver="auto", random_state=self.seed)
        pca.fit(to_numpy(pixels))
        self._fitted = {
            "mean": torch.from_numpy(pca.mean_).to(c),
            "basis": torch.from_numpy(pca.components_).to(c),
        }
        projected = to_numpy(self.project(c))
        distinct = np.unique(projected, axis=0)
        few = len(distinct) <= self.clusters
        centroids = distinct if few else _k_means(projected, self.clusters, self.seed)
        self._fitted["centroids"] = torch.from_numpy(centroids).to(c)
        return self

    def project(self, c: Tensor) -> Tensor:
        """Principal components and proprioception, (n, components + other columns)."""
        pixels, rest = self._split(check_condition(c))
        fitted = self._ready()
        if pixels.shape[1] != len(fitted["mean"]):
            raise ValueError(
                f"c has {pixels.shape[1]} columns of pixels, this was fitted on "
                f"{len(fitted['mean'])}"
            )
        mean, basis = fitted["mean"].to(pixels), fitted["basis"].to(pixels)
        return torch.cat([(pixels - mean) @ basis.T, rest], dim=1)

    def labels(self, c: Tensor) -> Tensor:
        """The number of the nearest centroid, (n,)."""
        return _nearest(self.project(c), self._ready()["centroids"])

    def __call__(self, c: Tensor) -> Tensor:
        """The centroid of each row, (n, components + other columns)."""
        return self._ready()["centroids"][self.labels(c)]

    def state_dict(self) -> dict[str, Tensor]:
        """What was fitted, to be saved with the weights."""
        return dict(self._fitted)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        self._fitted = dict(state)

    def _ready(self) -> dict[str, Tensor]:
        if not self._fitted:
            raise ValueError(f"{self!r} is not fitted: call fit(c) on the training conditions")
        return self._fitted

    def _split(self, c: Tensor) -> tuple[Tensor, Tensor]:
        pixels = c.shape[1] if self.pixels is None else self.pixels
        if pixels > c.shape[1]:
            raise ValueError(f"pixels is {pixels}, but c has only {c.shape[1]} columns")
        return c[:, :pixels], c[:, pixels:]

    def __repr__(self) -> str:
        return (
            f"PCAKMeansCondition(pixels={self.pixels}, components={self.components}, "
            f"clusters={self.clusters}, seed={self.seed})"
        )


class Viewed:
    """Clusters of what a function makes of the conditions: of pictures, of an encoder's features.

    Args:
        view: makes a matrix (n, m) of conditions (n, k); stays as it is.
        clusters: are fitted to the view.
        rows: at most so many of the training conditions, drawn at random, are viewed for that.
        seed: of the draw.
    """

    def __init__(
        self,
        view: Callable[[Tensor], Tensor],
        clusters: KMeansCondition | PCAKMeansCondition,
        *,
        rows: int = 20_000,
        seed: int = 0,
    ) -> None:
        if not callable(view):
            raise TypeError(f"view must be a function of c, got {view!r}")
        self.view, self.clusters = view, clusters
        self.rows = check_count(rows, "rows")
        self.seed = check_count(seed, "seed", minimum=0)

    def fit(self, c: Tensor) -> Self:
        """Fit the clusters to the view of c (n, k)."""
        c = check_condition(c)
        if len(c) > self.rows:
            rng = torch.Generator().manual_seed(self.seed)
            c = c[torch.randperm(len(c), generator=rng)[: self.rows].to(c.device)]
        self.clusters.fit(self._seen(c))
        return self

    def labels(self, c: Tensor) -> Tensor:
        """The number of each row's cluster, (n,)."""
        parts = check_condition(c).split(_VIEWED_AT_ONCE)
        return torch.cat([self.clusters.labels(self._seen(part)) for part in parts])

    def __call__(self, c: Tensor) -> Tensor:
        """The centroid of each row, in the space of the view's clusters."""
        parts = check_condition(c).split(_VIEWED_AT_ONCE)
        return torch.cat([self.clusters(self._seen(part)) for part in parts])

    def state_dict(self) -> dict[str, Tensor]:
        """What the clusters fitted."""
        return self.clusters.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Take back what `state_dict` gave."""
        self.clusters.load_state_dict(state)

    def _seen(self, c: Tensor) -> Tensor:
        with torch.no_grad():
            return check_condition(self.view(c), "view(c)")

    def __repr__(self) -> str:
        name = getattr(self.view, "__qualname__", None) or repr(self.view)
        return f"Viewed({name}, {self.clusters!r}, rows={self.rows}, seed={self.seed})"


def _mean_and_std(c: Tensor) -> tuple[Tensor, Tensor]:
    """Of each column; the standard deviation of a constant column is 0, whatever rounding says."""
    varies = (c != c[0]).any(dim=0)
    return c.mean(dim=0), torch.where(varies, c.std(dim=0, unbiased=False), 0)


def _scaled(c: Tensor, mean: Tensor, std: Tensor) -> Tensor:
    centred = c - mean
    return torch.where(std > 0, centred / std, torch.zeros_like(centred))


def _nearest(rows: Tensor, centroids: Tensor) -> Tensor:
    """The number of the nearest centroid; in float64, or near conditions are mistaken."""
    parts = rows.split(max(1, 10_000_000 // len(centroids)))
    points = centroids.double()
    return torch.cat([torch.cdist(part.double(), points).argmin(dim=1) for part in parts])


def _k_means(rows: Any, clusters: int, seed: int) -> Any:
    """Centroids by k-means++; for very many rows they are found on a sample of them."""
    rng = np.random.default_rng(seed)
    most = max(50_000, 16 * clusters)
    if len(rows) > most:
        rows = rows[rng.choice(len(rows), most, replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        found = KMeans(clusters, init="k-means++", n_init=1, random_state=seed).fit(rows)
    return found.cluster_centers_
