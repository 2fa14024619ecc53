"""Diagnostics of a trained network: the cost of fresh noise, and the sources of its error."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn import metrics
from cotlearn.couplings.base import Array, Coupling, Pairs, Sampler
from cotlearn.couplings.distances import to_numpy
from cotlearn.diagnostics.skew import MOST_ROWS, nearest, unit_variance
from cotlearn.flows.matching import Velocity
from cotlearn.flows.solvers import integrate, sampler
from cotlearn.randomness import Purpose, generator_for
from cotlearn.validation import check_count, check_function, check_has, check_seed

FINE = 128  #: Euler steps that stand for the exact solution


@dataclass(frozen=True)
class DeploymentGap:
    """Errors with coupled noise, as in training, and with fresh noise; squared W2 jointly with c.

    Attributes:
        coupled: mean error with noise from the coupling, as in training.
        fresh: mean error with fresh noise, as at test time.
        gap: fresh - coupled; about 0 without prior skew.
        gap_interval: 95 % interval over repetitions, Student's for fewer than ten.
    """

    coupled: float
    fresh: float
    gap: float
    gap_interval: tuple[float, float]


def deployment_gap(
    network: Velocity,
    data: Sampler,
    coupling: Coupling,
    *,
    held_out: Any = None,
    nfe: int = 1,
    n: int = 512,
    repetitions: int = 8,
    seed: int = 0,
) -> DeploymentGap:
    """Compare a network's error with noise from its coupling to its error with fresh noise.

    Both samples are compared with data of the same conditions, jointly with c (whose distance
    weighs 100 times the sample's). These data must not know the noise: of stored rows, as in a
    `Dataset`, each pair is given the x1 of the row outside its batch with the nearest condition;
    other data draw x1 given c. The x1 of the pair itself was chosen for its noise, and a network
    that has learned this would seem to be harmed by fresh noise also where p(x0 | c) is not
    skewed. The fresh noise is the coupled noise, shuffled.

    Args:
        network: the trained velocity field.
        data: the training data, or held-out data: rows `x1` and `c`, or with `sample_given`.
        coupling: the coupling that the network was trained with.
        held_out: data to compare with, if not `data`: needed where rows of `data` repeat one
            another, as windows of one episode do.
        nfe: Euler steps.
        n: pairs in each repetition, at least 100.
        repetitions: at least 2.
        seed: of pairs, noise and bootstrap.

    Raises:
        TypeError: the data have no condition.
        ValueError: n or repetitions is too small, or the coupling gives its pairs weights.
    """
    check_count(n, "n", minimum=100)
    seed = check_seed(seed)
    check_count(repetitions, "repetitions", minimum=2)
    check_has(coupling, "coupling", "a coupling such as Independent()", "stream")
    wanted = "data with a condition, as Dataset(x1, c)"
    if held_out is not None:
        check_has(held_out, "held_out", wanted, "x1" if hasattr(held_out, "x1") else "sample")
        if hasattr(held_out, "x1") and getattr(held_out, "c", None) is None:
            raise TypeError(f"held_out must be {wanted}, got none with c")
    stream = coupling.stream(data, batch_size=n, generator=torch.Generator().manual_seed(seed))
    errors = np.empty((repetitions, 2))
    for number in range(repetitions):
        pairs = next(stream)
        if pairs.c is None:
            raise TypeError("deployment_gap needs data with a condition c, got None")
        if pairs.weight is not None and pairs.weight.min() < pairs.weight.max():
            raise ValueError(f"coupling must count all rows alike, but {coupling!r} gives weights")
        shuffle = torch.randperm(n, generator=generator_for(seed, number, Purpose.SHUFFLED_NOISE))
        rng = generator_for(seed, number, Purpose.TRUTH)
        truth = _unpaired(data if held_out is None else held_out, pairs, rng)
        for k, x0 in enumerate((pairs.x0, pairs.x0[shuffle])):
            made = integrate(network, x0, pairs.c, nfe=nfe).x1
            errors[number, k] = metrics.joint_squared_w2(made, truth, pairs.c)
    coupled, fresh = (float(mean) for mean in errors.mean(axis=0))
    gaps = errors[:, 1] - errors[:, 0]
    interval = metrics.bootstrap_interval(gaps, seed=seed)
    return DeploymentGap(coupled, fresh, float(gaps.mean()), interval)


def _unpaired(data: Any, pairs: Pairs, generator: torch.Generator) -> Tensor:
    """Data (n, d) for the conditions of the pairs that know nothing of the pairs' noise."""
    assert pairs.c is not None
    if not hasattr(data, "x1") and hasattr(data, "sample_given"):
        drawn: Tensor = data.sample_given(pairs.c, generator=generator)
        return drawn
    x1, c = _others(data, pairs, generator)
    # Labels and numbers alike: of rows that are equally near one is drawn.
    ties = [1e-6 * torch.rand(len(some), 1, generator=generator) for some in (c, pairs.c)]
    places, wanted = (
        np.hstack([unit_variance(to_numpy(some), to_numpy(c)), to_numpy(tie)])
        for some, tie in zip((c, pairs.c), ties, strict=True)
    )
    return x1[torch.from_numpy(nearest(places, 1, of=wanted)[:, 0])]


def _others(data: Any, pairs: Pairs, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Rows of the data that are not among the pairs: those know each other's noise, too."""
    if hasattr(data, "x1"):
        rows = torch.randperm(len(data.x1), generator=generator)[:MOST_ROWS]
        x1, c = data.x1[rows], data.c[rows]
    else:
        x1, c = data.sample(MOST_ROWS, generator=generator)
    paired = {row.tobytes() for row in _rows(pairs.x1, pairs.c)}
    apart = torch.tensor([row.tobytes() not in paired for row in _rows(x1, c)])
    if apart.sum() < len(pairs.x1) / 2:
        raise ValueError(
            f"n must leave rows of the data to compare with, got {len(pairs.x1)} of {len(x1)}: "
            "take fewer, or give held_out"
        )
    return x1[apart], c[apart]


def _rows(x1: Tensor, c: Tensor | None) -> Array:
    """Data and condition beside each other."""
    assert c is not None
    return np.hstack([to_numpy(x1), to_numpy(c)])


@dataclass(frozen=True)
class ErrorBudget:
    """A squared W2 split into four parts, of which it is the sum.

    Attributes:
        floor: squared W2 between two fresh samples of the data.
        coupling: added by the exact field, integrated finely (prior skew).
        discretisation: added by taking only `nfe` steps of the exact field.
        network: added by the trained field at the same number of steps; negative if its errors
            cancel discretisation errors.
    """

    floor: float
    coupling: float
    discretisation: float
    network: float


def error_budget(
    network: Velocity,
    data: metrics.ConditionalData,
    oracle: Velocity,
    *,
    nfe: int,
    n: int = 1000,
    seed: int = 0,
) -> ErrorBudget:
    """Split the error of a network for a coupling whose exact velocity field is known.

    Args:
        network: the trained velocity field.
        data: has `sample_given` and `conditions`.
        oracle: the exact velocity field of the coupling: `data.velocity` of a mixture for
            independent pairs, or `AffineFlow.velocity`.
        nfe: Euler steps of the network.
        n: samples for each condition.
        seed: of all samples.
    """
    check_count(nfe, "nfe")
    seed = check_seed(seed)
    check_function(oracle, "oracle", "(t, x, c) -> v")
    size = data.sample_given(data.conditions()[:1]).shape[1]

    def error(sample: metrics.ConditionalSampler) -> float:
        rng = torch.Generator().manual_seed(seed)
        return metrics.conditional_squared_w2(sample, data, n=n, generator=rng)

    floor = error(data.sample_given)
    exact, coarse = (error(sampler(oracle, nfe=steps, dim=size)) for steps in (FINE, nfe))
    total = error(sampler(network, nfe=nfe, dim=size))
    return ErrorBudget(floor, exact - floor, coarse - exact, total - coarse)
