"""Metrics: distances between samples, straightness of paths, confidence intervals."""

import functools
import math
import warnings
from collections.abc import Callable
from typing import Protocol, TypeAlias

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.assignment import exact_permutation
from cotlearn.couplings.base import Array
from cotlearn.couplings.distances import squared_distances, to_numpy
from cotlearn.flows.matching import evaluate

CONFIDENCE = 0.95  #: level of all intervals
FEW = 10  #: values, below which a bootstrap interval is too narrow
STEPS = 64  #: Euler steps of `straightness`
AT_ONCE = 20_000_000  #: numbers that a metric holds in memory at once
#: `sample(c, generator=g)` draws one row for each row of c, shape (n, d).
ConditionalSampler: TypeAlias = Callable[..., Tensor]
Interval: TypeAlias = tuple[float, float]  #: its ends, low and high


class ConditionalData(Protocol):
    """Data that can be sampled given a condition."""

    def sample_given(self, c: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """Draw one x for each row of c (n, k), shape (n, d)."""

    def conditions(self, n: int = 9) -> Tensor:
        """Conditions to evaluate on, shape (m, k)."""


def squared_w2(a: Tensor, b: Tensor) -> float:
    """The exact squared 2-Wasserstein distance between two samples.

    Args:
        a: (n, d).
        b: (m, d); n and m may differ.
    """
    validation.check_matrix(a, "a")
    validation.check_matrix(b, "b", columns=a.shape[1])
    validation.check_squares(a=a, b=b)
    cost = squared_distances(a, b)
    n, m = cost.shape
    if n == m:
        return float(cost[np.arange(n), exact_permutation(cost)].mean())
    import ot  # late: it takes two seconds

    scale = float(cost.mean()) or 1.0  # POT's simplex has an absolute tolerance
    even = np.full(n, 1 / n), np.full(m, 1 / m)
    return scale * float(ot.emd2(*even, cost / scale, numItermax=10_000_000))


def joint_squared_w2(a: Tensor, b: Tensor, c: Tensor) -> float:
    """Squared W2 between samples a and b of the same conditions c, jointly with c.

    The squared distance of conditions weighs 100 times that of the rows of b on average, so that
    samples are hardly matched across conditions: let b be the truth, which is the same for all
    models. Swapped, a and b of unlike spread give another value. Use it for continuous c, where
    each value occurs once; with many samples per condition, `conditional_squared_w2` is more
    informative.

    Args:
        a: (n, d).
        b: (n, d).
        c: (n, k), the condition of row i of a and of row i of b.
    """
    validation.check_matrix(a, "a")
    validation.check_matrix(b, "b", columns=a.shape[1])
    c = validation.check_condition(c)
    for value, name in ((b, "b"), (c, "c")):
        validation.check_same_rows(value, name, a, "a")
    validation.check_squares(a=a, b=b, c=c)
    spread = squared_distances(c, c).mean()
    scale = (100 * squared_distances(b, b).mean() / spread) ** 0.5 if spread else 0.0
    heavy = scale * c.double()
    return squared_w2(*(torch.cat([x.double(), heavy], dim=1) for x in (a, b)))


def conditional_squared_w2(
    sample: ConditionalSampler,
    data: ConditionalData,
    *,
    n: int = 1000,
    generator: torch.Generator | None = None,
) -> float:
    """Squared W2 between n samples and n fresh samples of p(x | c), averaged over conditions.

    Two finite samples of the same law differ, so even perfect samples do not reach 0. Report the
    floor, `conditional_squared_w2(data.sample_given, data, ...)`, beside the value. Data of stored
    rows need 2n rows of each condition: else the two samples of the floor share rows, which makes
    it too low, and of fewer than n rows no value means much.

    Args:
        sample: sample(c, generator=g) draws one row for each row of c.
        data: has `sample_given` and `conditions`.
        n: samples for each condition.
        generator: randomness of both samples.

    Warns (RuntimeWarning) if stored rows of a condition are fewer than 2n.
    """
    validation.check_function(sample, "sample", "(c, generator) -> x")
    validation.check_generator(generator)
    validation.check_count(n, "n")
    check = validation.check_has
    check(data, "data", "data with conditions, as Dataset(x1, c)", "conditions", "sample_given")
    stored, values = getattr(data, "c", None), []
    for row in data.conditions():
        if isinstance(stored, Tensor) and (rows := int((stored == row).all(dim=1).sum())) < 2 * n:
            warnings.warn(
                f"data has {rows} rows of condition {validation.short(row.tolist())}, fewer than "
                f"twice n = {n}: their floor is too low; take a smaller n, or data with a law",
                RuntimeWarning,
                stacklevel=2,
            )
            stored = None  # once
        repeated = row.expand(n, -1)
        truth = data.sample_given(repeated, generator=generator)
        drawn = sample(repeated.clone(), generator=generator)
        for x, name in ((truth, "data.sample_given(c)"), (drawn, "sample(c)")):
            validation.check_matrix(x, name)
            validation.check_same_rows(x, name, repeated, "c")
        values.append(squared_w2(drawn, truth))
    return float(np.mean(values))


def l2_uvp(mapped: Tensor, truth: Tensor, *, variance: float | None = None) -> float:
    """The unexplained variance of a map in percent, 100 E|T - T*|^2 / Var (Korotin 2106.01954).

    0 means the true map; 100 is no better than the constant map to the mean.

    Args:
        mapped: (n, d), T of some points.
        truth: (n, d), T* of the same points.
        variance: the trace of the data's covariance, averaged over conditions if there are any; if
            None, the variance of `truth`.
    """
    validation.check_matrix(mapped, "mapped")
    validation.check_matrix(truth, "truth", columns=mapped.shape[1])
    validation.check_same_rows(mapped, "mapped", truth, "truth")
    if variance is None:
        if len(truth) < 2:
            raise ValueError("variance is missing: it needs at least 2 rows of truth, got 1")
        variance = float(truth.double().var(dim=0).sum())
    error = (mapped.double() - truth.double()).square().sum(dim=1).mean()
    return 100 * float(error) / validation.check_positive(variance, "variance")


def energy_distance(a: Tensor, b: Tensor) -> float:
    """2 E|X - Y| - E|X - X'| - E|Y - Y'| between two samples (Szekely & Rizzo), unbiased.

    For two samples of the same law its mean is 0, so it can be negative.

    Args:
        a: (n, d), n at least 2.
        b: (m, d), m at least 2.
    """
    validation.check_matrix(a, "a")
    validation.check_matrix(b, "b", columns=a.shape[1])
    if min(len(a), len(b)) < 2:
        raise ValueError(f"a and b need at least 2 rows each, got {len(a)} and {len(b)}")
    x, y = to_numpy(a), to_numpy(b)
    n, m = len(x), len(y)
    within_x = cdist(x, x).sum() / (n * (n - 1))
    within_y = cdist(y, y).sum() / (m * (m - 1))
    return float(2 * cdist(x, y).mean() - within_x - within_y)


@torch.no_grad()
def straightness(
    velocity: Callable[[Tensor, Tensor, Tensor | None], Tensor], x0: Tensor, c: Tensor | None = None
) -> float:
    """E int |v(t, x_t, c) - (x1 - x0)|^2 dt along the flow's own paths (Liu 2209.03003, eq. 3).

    0 means that the paths are straight and one Euler step is exact. The paths are those of 64 Euler
    steps, and so are their velocities: of a field that changes much within one step the value is
    rough (up to 5 % off on the mixtures of the course).

    Args:
        velocity: the velocity field.
        x0: (n, d) noise at t = 0.
        c: (n, k), or None.
    """
    validation.check_function(velocity, "velocity", "(t, x, c) -> v")
    validation.check_sampled(velocity, x0, c, of="velocity")
    path = [x0.to(torch.promote_types(x0.dtype, torch.float32))]  # steps would be rounded away
    for step in range(STEPS):
        t = torch.tensor(step / STEPS, dtype=x0.dtype, device=x0.device)
        v = evaluate(velocity, t, path[-1].to(x0.dtype), c)
        path.append(path[-1] + 1 / STEPS * v)
    states = torch.stack(path).double()  # in single precision the square of 1e20 is infinite
    velocities = (states[1:] - states[:-1]) * STEPS
    found = float((velocities - (states[-1] - states[0])).square().sum(dim=2).mean())
    if not math.isfinite(found):
        raise ValueError("velocity must be finite along its own paths, got NaN or infinite values")
    return found


def wilson_interval(successes: int, trials: int) -> Interval:
    """Wilson's 95 % interval for a probability of success, both ends in [0, 1].

    Args:
        successes: number of successes, from 0 to trials.
        trials: number of trials, from 1 to 2^53.
    """
    validation.check_count(trials, "trials", most=2**53)
    validation.check_count(successes, "successes", minimum=0, most=trials, of="trials {}")
    from scipy import stats  # late: it takes a second

    interval = stats.binomtest(successes, trials).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)


def bootstrap_interval(values: ArrayLike, *, seed: int = 0, resamples: int = 10_000) -> Interval:
    """The 95 % interval of the mean: by the percentile bootstrap, of few values by Student's t.

    The bootstrap of three values covers the mean in 74 % of the cases, of five in 83 %; so below
    ten values the interval is Student's. Of ten to twenty values it covers about 90 %.

    Args:
        values: one value per seed, episode or condition; at least 2.
        seed: of the resampling.
        resamples: number of bootstrap means.
    """
    array = validation.check_array(values, "values", (...,)).ravel()
    if len(array) < 2:
        raise ValueError(f"values must be at least 2 numbers, got {array.tolist()}")
    rng = np.random.default_rng(validation.check_seed(seed))
    resamples = validation.check_count(resamples, "resamples")
    if len(array) < FEW:
        half = student(len(array) - 1) * float(array.std(ddof=1)) / len(array) ** 0.5
        return float(array.mean()) - half, float(array.mean()) + half
    at_once = max(1, AT_ONCE // len(array))
    parts = [min(at_once, resamples - k) for k in range(0, resamples, at_once)]
    means = [rng.choice(array, size=(part, len(array))).mean(axis=1) for part in parts]
    return _percentiles(np.concatenate(means))


def student(freedom: int) -> float:
    """The quantile of Student's t of all two-sided intervals, for at least 1 degree of freedom."""
    from scipy import stats  # late: it takes a second

    return float(stats.t.ppf((1 + CONFIDENCE) / 2, freedom))


def paired_bootstrap(
    first: ArrayLike, second: ArrayLike, *, deviation: float = 0.0, seed: int = 0
) -> tuple[float, float, float]:
    """The mean of first - second, and its 95 % percentile bootstrap interval.

    Training seeds and episodes are resampled independently, as crossed factors, because all seeds
    are evaluated on the same episodes. With one seed the interval is that of these two networks:
    it holds for their methods only if it is widened by the deviation between networks, which other
    rows must tell. With three seeds it covers 92 % if networks deviate by .05, and 86 % if by .10.

    Args:
        first: (seeds, episodes), scores of one method.
        second: (seeds, episodes), scores of another method on the same seeds and episodes.
        deviation: standard deviation of the difference between networks; used with one seed only.
        seed: of the resampling.

    Returns:
        Mean, lower end, upper end.
    """
    a = validation.check_array(first, "first", (None, None))
    difference = a - validation.check_array(second, "second", a.shape)
    seeds, episodes = difference.shape
    if episodes < 2:
        raise ValueError(f"first must have at least 2 episodes (columns), got shape {a.shape}")
    often, which = _resamples(seeds, episodes, validation.check_seed(seed))
    means = np.einsum("rs,re,se->r", often, which, difference, optimize=True)
    deviation = validation.check_number(deviation, "deviation")
    if seeds == 1:
        means = means + deviation * np.random.default_rng(seed).standard_normal(len(means))
    return float(difference.mean()), *_percentiles(means)


@functools.lru_cache(maxsize=8)
def _resamples(seeds: int, episodes: int, seed: int) -> tuple[Array, Array]:
    """How often each seed and each episode counts, as shares, in 5,000 resamples."""
    rng = np.random.default_rng(seed)
    often = rng.multinomial(seeds, np.full(seeds, 1 / seeds), size=5000) / seeds
    which = rng.multinomial(episodes, np.full(episodes, 1 / episodes), size=5000) / episodes
    return often, which


def _percentiles(means: Array) -> Interval:
    low, high = np.quantile(means, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return float(low), float(high)


def energy_score(samples: Tensor, truth: Tensor) -> float:
    """E|X - y| - E|X - X'| / 2, averaged over conditions (Gneiting & Raftery 2007, eq. 22).

    This is a proper score: no law of X has a lower mean than the law of y. It needs only one y for
    each condition, and the estimate is unbiased.

    Args:
        samples: (m, n, d), m at least 2 samples for each of n conditions.
        truth: (n, d), the observation y for each condition.
    """
    return float(energy_scores(samples, truth).mean())


def energy_scores(samples: Tensor, truth: Tensor) -> Tensor:
    """`energy_score` of each condition, (n,), for paired comparisons and their intervals.

    Args:
        samples: (m, n, d), m at least 2 samples for each of n conditions.
        truth: (n, d), the observation y for each condition.
    """
    validation.check_matrix(truth, "truth")
    if np.ndim(samples) != 3 or (m := len(samples)) < 2:
        got = tuple(np.shape(samples))
        raise ValueError(f"samples must have shape (at least 2, n, d), got {got}")
    validation.check_shape(samples, "samples", (m, *truth.shape))
    validation.check_matrix(samples.flatten(0, 1), "samples")
    validation.check_squares(samples=samples.flatten(0, 1), truth=truth)
    samples = samples.double()  # in single precision the square of 1e19 is infinite
    off = (samples - truth).norm(dim=2).mean(dim=0)
    by_row = samples.transpose(0, 1)
    direct = "donot_use_mm_for_euclid_dist"  # a product loses digits far from 0
    blocks = by_row.split(max(1, AT_ONCE // m**2))
    among = torch.cat([torch.cdist(x, x, compute_mode=direct).sum(dim=(1, 2)) for x in blocks])
    return off - among / (m * (m - 1)) / 2


def mode_entropy(modes: ArrayLike) -> float:
    """The entropy of the samples' modes in nats, averaged over conditions.

    It is 0 if every condition has one mode, and log K if K modes are equally frequent. The entropy
    of counts is biased by about -(K - 1) / (2 draws): compare it to the entropy of demonstrations
    with equally many draws.

    Args:
        modes: (conditions, draws), integers; a negative value is a failed draw and does not count.
            A condition with only failed draws has entropy 0.
    """
    array = validation.check_real(modes, "modes", "iu")
    if array.ndim != 2 or array.size == 0:
        raise ValueError(f"modes must have shape (conditions, draws), got {array.shape}")
    counts = [np.unique(row[row >= 0], return_counts=True)[1] for row in array]
    from scipy import stats  # late: it takes a second

    return float(np.mean([stats.entropy(count) if len(count) else 0.0 for count in counts]))
