"""Diagnostics of a trained network: the cost of fresh noise, and the sources of its error."""

from dataclasses import dataclass

import numpy as np
import torch

from cotlearn import metrics
from cotlearn.couplings.base import Coupling, Sampler, generator_for
from cotlearn.flows.matching import Velocity
from cotlearn.flows.solvers import integrate, sampler
from cotlearn.validation import check_count, check_function, check_has

FINE = 128  #: Euler steps that stand for the exact solution


@dataclass(frozen=True)
class DeploymentGap:
    """Errors with coupled noise, as in training, and with fresh noise; squared W2 jointly with c.

    Attributes:
        coupled: mean error with noise from the coupling, as in training.
        fresh: mean error with fresh noise, as at test time.
        gap: fresh - coupled; about 0 without prior skew.
        gap_interval: 95 % bootstrap interval over repetitions.
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
    nfe: int = 1,
    n: int = 512,
    repetitions: int = 8,
    seed: int = 0,
) -> DeploymentGap:
    """Compare a network's error with noise from its coupling to its error with fresh noise.

    Both samples are compared with fresh data of the same conditions, jointly with c (whose distance
    weighs 100 times the sample's). The fresh noise is the coupled noise, shuffled. If the data
    cannot draw x1 given c, or every condition occurs only once, the samples are compared with the
    x1 of the pairs, and `coupled` is too small by up to the sampling floor.

    Args:
        network: the trained velocity field.
        data: the training data, or held-out data.
        coupling: the coupling that the network was trained with.
        nfe: Euler steps.
        n: pairs in each repetition, at least 100.
        repetitions: at least 2.
        seed: of pairs, noise and bootstrap.

    Raises:
        TypeError: the data have no condition.
        ValueError: n or repetitions is too small.
    """
    check_count(n, "n", minimum=100)
    check_count(seed, "seed", minimum=0)
    check_count(repetitions, "repetitions", minimum=2)
    check_has(coupling, "coupling", "a coupling such as Independent()", "stream")
    stream = coupling.stream(data, batch_size=n, generator=torch.Generator().manual_seed(seed))
    errors = np.empty((repetitions, 2))
    for number in range(repetitions):
        pairs = next(stream)
        if pairs.c is None:
            raise TypeError("deployment_gap needs data with a condition c, got None")
        shuffle = torch.randperm(n, generator=generator_for(seed, number, purpose=10))
        truth = pairs.x1
        if hasattr(data, "sample_given"):  # drawn independently of the pairs' noise
            truth = data.sample_given(pairs.c, generator=generator_for(seed, number, purpose=12))
        for k, x0 in enumerate((pairs.x0, pairs.x0[shuffle])):
            made = integrate(network, x0, pairs.c, nfe=nfe).x1
            errors[number, k] = metrics.joint_squared_w2(made, truth, pairs.c)
    coupled, fresh = (float(mean) for mean in errors.mean(axis=0))
    gaps = errors[:, 1] - errors[:, 0]
    interval = metrics.bootstrap_interval(gaps, seed=seed)
    return DeploymentGap(coupled, fresh, float(gaps.mean()), interval)


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
    check_count(seed, "seed", minimum=0)
    check_function(oracle, "oracle", "(t, x, c) -> v")
    size = data.sample_given(data.conditions()[:1]).shape[1]

    def error(sample: metrics.ConditionalSampler) -> float:
        rng = torch.Generator().manual_seed(seed)
        return metrics.conditional_squared_w2(sample, data, n=n, generator=rng)

    floor = error(data.sample_given)
    exact, coarse = (error(sampler(oracle, nfe=steps, dim=size)) for steps in (FINE, nfe))
    total = error(sampler(network, nfe=nfe, dim=size))
    return ErrorBudget(floor, exact - floor, coarse - exact, total - coarse)
