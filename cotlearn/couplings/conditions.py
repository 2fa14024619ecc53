"""Conditions as a coupling sees them: standardised, clustered, projected or combined.

The network is always given the condition itself; these functions decide what the *coupling* sees.
Each is fitted once, on the training set, and then called as f(c) -> (n, m).
"""

import copy
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any, Self

import numpy as np
import torch
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.base import WithOptions, lent
from cotlearn.couplings.distances import to_numpy
from cotlearn.couplings.unheeded import warn_if_unresolved
from cotlearn.couplings.units import OwnUnits, tamed
from cotlearn.datasets import Standardiser

LARGEST_SEED = 2**32 - 1  #: that scikit-learn takes
ROWS_AT_ONCE = 4096  #: rows whose distances to the centroids are held in memory at once
SOME = 0.05  #: share of the rows of the fit that lie farther from the clusters than is usual
BEYOND = 3.0  #: times the usual distance, beyond which as large a share gets a warning
SHRUNK, ENOUGH = 0.02, 32  #: part of its deviation in the fit that a column has, of so many rows
FAR_OFF = 1e3  #: deviations that the mean of a column lies from 0, from which it is taken off
LONG = 2e7  #: rows times clusters from which k-means takes more than some seconds, and says so


def combine(conditions: Mapping[str, Tensor], weights: Mapping[str, float] | None = None) -> Tensor:
    """Standardise several named conditions, weight them, and concatenate their columns.

    The squared distance of two rows is then sum_name w_name |difference|^2 / columns. A condition
    of weight 1 contributes 2 on average, whatever its scale and number of columns (constant columns
    do not count). Values far from all others, as -9999 for a missing one, are drawn near first, and
    columns of several scales ranked (see `OwnUnits`): else their column would hold nothing else.

    Give these columns to what takes them as they are: `ConditionalOT` with "balanced" or a number,
    or strata of `KMeansCondition(K, standardise=False)`. Others measure each column in a unit of
    its own again, so that weights do nothing: `ConditionalOT()`, `StratifiedOT(K)`.

    Args:
        conditions: name -> (n, k_name).
        weights: name -> weight, at least 0; names that are left out have weight 1.

    Returns:
        (n, sum of all k_name).

    Raises:
        TypeError: conditions or weights is no dictionary.
        ValueError: conditions is empty, their rows differ, weights has an unknown name, or a weight
            is negative, or so large that the columns overflow.
    """
    _check_names(conditions, "conditions")
    _check_names({} if weights is None else weights, "weights")
    if not conditions:
        raise ValueError("conditions is empty: give at least one named condition")
    weights = {} if weights is None else weights
    unknown = sorted(set(weights) - set(conditions), key=str)
    if unknown:
        known = sorted(conditions, key=str)
        raise ValueError(f"weights has unknown names {unknown}, expected {known}")
    parts: list[Tensor] = []
    first_name, first = next(iter(conditions.items()))
    for name, c in conditions.items():
        c = validation.check_condition(c, name)
        validation.check_same_rows(c, name, first, first_name)
        weight = validation.check_number(weights.get(name, 1.0), f"weights[{name!r}]")
        c = tamed(c)
        scaler = Standardiser.fit(c)
        varying = max(1, int((scaler.std > 0).sum()))
        weighted = scaler(c) * math.sqrt(weight / varying)
        if not weighted.isfinite().all():
            raise ValueError(f"weights[{name!r}] is {weight:.3g}, too large for {c.dtype}")
        parts.append(weighted)
    return torch.cat(parts, dim=1)


def _check_names(value: Any, name: str) -> None:
    if not isinstance(value, Mapping):
        kind = type(value).__name__
        raise TypeError(f"{name} must be a dictionary of names, as {{'label': ...}}, got {kind}")


class Clusters(WithOptions):
    """Abstract base class: groups conditions by their nearest centroid.

    Calling it on c (n, k) returns the nearest centroid of each row, (n, m); `labels(c)` returns the
    centroids' indices. A subclass overrides `_fit` and `project`.
    """

    clusters: int
    seed: int = 0
    own = False  #: whether a coupling made them from a number: another must not get them fitted
    fitted_to = b""  #: digest of what a coupling fitted them to; it fits others to other data
    _fitted: Mapping[str, Tensor] = {}
    _needed: tuple[str, ...] = ()  # tensors that `project` takes

    def __post_init__(self) -> None:
        validation.check_count(self.clusters, "clusters")
        validation.check_count(self.seed, "seed", minimum=0, most=LARGEST_SEED)

    def fit(self, c: Tensor) -> Self:
        """Find the centroids of the training conditions c (n, k).

        Raises:
            ValueError: there are more clusters than rows.
        """
        c = validation.check_condition(c).detach()  # whose graph would be kept with the centroids
        validation.check_count(self.clusters, "clusters", most=len(c), of="the {} rows of c")
        half = copy.copy(self)  # other threads must not meet clusters that are half fitted
        half._fitted = self._fit(c)
        seen = half.project(c)
        centroids = torch.from_numpy(_k_means(to_numpy(seen), self.clusters, self.seed))
        half._fitted = {**half._fitted, "centroids": centroids.to(c)}
        far, label, _ = half._nearest(c)
        between = torch.cdist(centroids, centroids).fill_diagonal_(math.inf).min(dim=1).values
        half_way = float(between[label.cpu()].median()) / 2
        usual = float(far.sort().values[int((1 - SOME) * (len(far) - 1))])  # tails may be heavy
        limit = half_way if far.max() == 0 else BEYOND * max(usual, half_way)
        limit = 0.0 if math.isinf(limit) else limit
        scale = seen.double().std(dim=0, unbiased=False)
        self._fitted = {**half._fitted, "limit": torch.tensor(limit).to(c), "scale": scale.to(c)}
        return self

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        """Fit the tensors that `project` needs."""
        raise NotImplementedError

    def project(self, c: Tensor) -> Tensor:
        """Map c (n, k) into the space of the centroids, (n, m)."""
        raise NotImplementedError

    @property
    def centroids(self) -> Tensor:
        """The centroids (K, m), in the space of `project`."""
        return self._ready("centroids")

    def labels(self, c: Tensor) -> Tensor:
        """The index 0 .. K-1 of each row's nearest centroid, (n,); distances are in float64."""
        far, labels, seen = self._nearest(validation.check_condition(c))
        known = getattr(self, "inner", self)._fitted
        if "limit" in known:
            self._warn_if_unlike(far, seen, float(known["limit"]), known["scale"].to(seen))
        return labels

    def _warn_if_unlike(self, far: Tensor, seen: Tensor, limit: float, scale: Tensor) -> None:
        """Warn of conditions that are not as those of the fit, so that clusters mix them.

        Args:
            far: (n,), the distances to the nearest centroids.
            seen: (some rows, m), in the space of the centroids.
            limit: of these distances; 0 if there is one cluster only.
            scale: (m,), the standard deviations of the rows of the fit.
        """
        beyond = float((far > limit).double().mean()) if limit > 0 and len(far) else 0.0
        now = seen.std(dim=0, unbiased=False)
        shrunk = ((now > 0) & (now < SHRUNK * scale)).nonzero()[:, 0].tolist()
        what = ""
        if beyond > SOME:
            what = f"{beyond:.0%} of the rows of c lie far from all of these"
        elif shrunk and len(seen) >= ENOUGH:
            what = f"column {shrunk[0]} of what they see varies much less than it did"
        if what:
            warnings.warn(
                f"{self!r} was fitted to other conditions: {what}, so that rows are put together "
                "that differ; give c in the units of the fit, or fit again",
                stacklevel=4,
            )

    def _nearest(self, c: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The distance to each row's nearest centroid, its index, (n,); the first rows as seen."""
        centroids = self.centroids.to(c.device, torch.float64)
        centre = centroids.mean(dim=0)  # far from 0 the distances would lose digits
        near = centroids - centre
        far = torch.empty(len(c), dtype=torch.float64, device=c.device)
        labels = torch.empty(len(c), dtype=torch.long, device=c.device)
        seen = centroids[:0]
        # filled in place: small results that are kept between large blocks can break up the heap
        for first in range(0, len(c), ROWS_AT_ONCE):
            some = slice(first, first + ROWS_AT_ONCE)
            part = self.project(c[some]).double()
            away = torch.cdist(part - centre, near).min(dim=1)
            far[some], labels[some] = away.values, away.indices
            seen = seen if first else part
        return far, labels, seen

    def __call__(self, c: Tensor) -> Tensor:
        """The nearest centroid of each row of c (n, k), (n, m)."""
        return self.centroids.to(c.device)[self.labels(c)]

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted tensors, to be saved with the weights."""
        return dict(self._fitted)

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned.

        Raises:
            ValueError: it is of clusters of another kind or number.
        """
        if missing := {"centroids", *self._needed} - state.keys():
            raise ValueError(f"state must be of {self!r}: it has no {min(missing)!r}")
        if (count := len(state["centroids"])) > self.clusters:
            raise ValueError(f"state must be of {self!r}, got {count} centroids")
        self._fitted = dict(state)

    def _ready(self, name: str) -> Tensor:
        if not self._fitted:
            raise ValueError(f"{self!r} is not fitted: call fit(c) on the training conditions")
        return self._fitted[name]


@dataclass(repr=False)
class KMeansCondition(Clusters):
    """The nearest of K centroids, fitted by k-means++ to standardised conditions.

    The centroids (K, k) are in standardised units. Values far from all others are drawn near first,
    and columns of several scales ranked, as in `combine`.

    Args:
        clusters: K, at least 1. If there are at most K distinct conditions, each is a centroid.
        seed: of k-means++.
        standardise: False takes the columns as they are, with the weights that `combine` gave them.
    """

    clusters: int = 64
    _: KW_ONLY
    seed: int = 0
    standardise: bool = True
    _needed = "mean", "std"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.standardise, bool):
            raise TypeError(f"standardise must be True or False, got {self.standardise!r}")

    def fit(self, c: Tensor) -> Self:
        """Find the centroids of c (n, k); warn if they tell apart most columns, but not all."""
        super().fit(c)
        warn_if_unresolved(self.project(c), self.labels(c))
        return self

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        if not self.standardise:
            return {"mean": torch.zeros_like(c[0]), "std": torch.ones_like(c[0])}
        units = OwnUnits.fit(c)
        near = units.tamed(c)
        scaler = Standardiser.fit(near)
        own = {} if near is c else vars(units)
        return {"mean": scaler.mean, "std": scaler.std, **own}

    def project(self, c: Tensor) -> Tensor:
        """The conditions in the units of the centroids, (n, k)."""
        mean, std = (self._ready(name).to(c.device) for name in ("mean", "std"))
        c = validation.check_condition(c, columns=len(mean))
        if "centre" in self._fitted:
            units = OwnUnits(**{f.name: self._fitted[f.name] for f in fields(OwnUnits)})
            c = units.tamed(c)
        return Standardiser(mean, std)(c)


@dataclass(repr=False, kw_only=True)
class PCAKMeansCondition(Clusters):
    """COT Policy's condition for images (2505.01179): PCA of raw pixels, then k-means.

    The condition c is one matrix: first the flattened pixels, then proprioception. The pixels are
    centred by the mean of the training set (the published code uses each batch's mean) and
    projected to principal components; proprioception is appended unscaled. Each row is then
    replaced by the nearest of K centroids.

    Args:
        pixels: number of leading columns of c that are pixels; all columns if None.
        components: number of principal components, at most the training rows and at most pixels.
        clusters: K, at least 1.
    """

    pixels: int | None = None
    components: int = 100
    clusters: int = 64
    _needed = "mean", "basis"

    def __post_init__(self) -> None:
        super().__post_init__()
        validation.check_count(self.components, "components")
        if self.pixels is not None:
            validation.check_count(self.pixels, "pixels")

    def _fit(self, c: Tensor) -> dict[str, Tensor]:
        pixels = c[:, : self.pixels]
        if self.pixels not in (None, pixels.shape[1]):
            raise ValueError(f"pixels is {self.pixels}, but c has only {c.shape[1]} columns")
        most = min(pixels.shape)
        validation.check_count(self.components, "components", most=most, of="{} for this c")
        from sklearn.decomposition import PCA  # late: it takes a second

        values = to_numpy(pixels)
        mean, spread = values.mean(axis=0), values.std(axis=0)
        mean[np.abs(mean) < FAR_OFF * spread] = 0.0  # PCA loses the digits of a larger one
        pca = PCA(self.components, random_state=self.seed).fit(values - mean)
        fitted = {"mean": mean + pca.mean_, "basis": pca.components_}
        return {name: torch.from_numpy(value).to(c) for name, value in fitted.items()}

    def project(self, c: Tensor) -> Tensor:
        """Principal components, then proprioception: (n, components + other columns)."""
        c = validation.check_condition(c)
        mean, basis = (self._ready(name).to(c) for name in ("mean", "basis"))
        pixels = validation.check_matrix(c[:, : self.pixels], "the pixels of c", columns=len(mean))
        with torch.autocast(c.device.type, enabled=False):  # half precision gives other clusters
            components = (pixels - mean) @ basis.T
        return torch.cat([components, c[:, len(mean) :]], dim=1)


@dataclass(repr=False)
class EmbeddedClusters(Clusters):
    """Clusters of embedded conditions, for instance of an image encoder's features.

    Args:
        embed: maps conditions (n, k) to a matrix (n, m); it is not trained.
        inner: clusters that are fitted to the embedding.
        rows: largest number of training conditions, drawn at random, to fit `inner` to.
    """

    embed: Callable[[Tensor], Tensor]
    inner: Clusters
    _: KW_ONLY
    rows: int = 20_000

    def __post_init__(self) -> None:
        validation.check_function(self.embed, "embed", "of c")
        self._check_embed()
        wanted = "clusters such as KMeansCondition()"
        validation.check_has(self.inner, "inner", wanted, "fit", "project")
        validation.check_count(self.rows, "rows")

    def _check_embed(self) -> None:
        validation.check_draws_nothing(
            self.embed, "embed", "a condition gets other clusters each time"
        )

    def fit(self, c: Tensor) -> Self:
        """Fit a copy of `inner` to the embedding of c (n, k)."""
        c = validation.check_condition(c)
        if len(c) > self.rows:
            rng = torch.Generator().manual_seed(self.seed)
            c = c[torch.randperm(len(c), generator=rng)[: self.rows].to(c.device)]
        features = self._embedded(c)
        if bool((features == features[0]).all()) and bool((c != c[0]).any()):
            warnings.warn(
                "embed(c) is the same for all conditions, which fall into one cluster: noise is "
                "paired across them",
                stacklevel=3,
            )
        self.inner = copy.copy(self.inner).fit(features)
        return self

    def project(self, c: Tensor) -> Tensor:
        """Embed c (n, k) and map it into the space of the centroids, (n, m)."""
        return self.inner.project(self._embedded(c))

    @property
    def centroids(self) -> Tensor:
        """The centroids (K, m) of `inner`."""
        return self.inner.centroids

    def state_dict(self) -> dict[str, Tensor]:
        """The fitted tensors of `inner`."""
        return self.inner.state_dict()

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Restore the state that `state_dict` returned."""
        self.inner = copy.copy(self.inner)
        self.inner.load_state_dict(state)

    def _embedded(self, c: Tensor) -> Tensor:
        self._check_embed()  # somebody may train it meanwhile
        with torch.no_grad():
            return validation.check_condition(self.embed(*lent(c)), "embed(c)")


def _k_means(rows: Any, clusters: int, seed: int) -> Any:
    """Centroids by k-means++ (on a sample of large data); the distinct rows if they are few."""
    distinct = np.unique(rows, axis=0)
    if len(distinct) <= clusters:
        return distinct
    rng = np.random.default_rng(seed)
    most = max(50_000, 16 * clusters)
    if len(rows) > most:
        rows = rows[rng.choice(len(rows), most, replace=False)]
    from sklearn.cluster import KMeans  # late: it takes a second

    from cotlearn.progress import progress_bar

    what = f"grouping {len(rows):,} conditions into {clusters:,} clusters, once"
    show = None if len(rows) * clusters > LONG else False
    with progress_bar(total=1, what=what, show=show) as bar:
        found = KMeans(clusters, n_init=1, random_state=seed).fit(rows).cluster_centers_
        bar.update()
    return found
