"""Named streams of random numbers: everything random derives from a seed, a number and a purpose.

Streams of different purposes are independent, so a new use of randomness changes no old result.
"""

from enum import IntEnum, unique

import numpy as np
from torch import Generator


@unique
class Purpose(IntEnum):
    """What random numbers are for. A value that stored results depend on must not change."""

    ROWS = 0  #: the rows and the noise of a batch; the rows that a frontier holds out
    LOSS = 1  #: times, noise and shifts inside a loss
    ORDER = 2  #: the order in which the pairs of an epoch are cut into batches
    PREPARATION = 3  #: what a coupling draws before the first batch, as rows for clusters
    POTENTIAL = 4  #: the ascent of a semidiscrete potential
    STEP_SIZE = 5  #: the rows by which that ascent's step sizes are chosen
    MARGINAL = 6  #: the noise by which a fitted potential is judged
    SKEW = 7  #: the shuffled conditions of a test for prior skew in a frontier
    ONE_STEP_ERROR = 8  #: rows and fresh noise of a frontier's one-step error
    NEIGHBOURS = 9  #: the rows by which a semidiscrete coupling counts candidates
    SHUFFLED_NOISE = 10  #: which noise a deployment gap gives to another condition
    WEIGHTED_PAIRS = 11  #: which weighted pairs a frontier keeps
    TRUTH = 12  #: fresh data of a deployment gap
    ROLLOUT = 13  #: noise of a rollout
    PROBE = 14  #: batches, held-out rows and noise of a probe
    HELD_OUT_CHUNKS = 17  #: states and noise of a policy's energy score
    TEACHER = 21  #: conditions and noise of the pairs that a teacher makes


def generator_for(seed: int, number: int, purpose: int = Purpose.ROWS) -> Generator:
    """A generator seeded by (seed, number, purpose) only, the same on every machine.

    Args:
        seed: any integer.
        number: of a batch, a step, a repetition.
        purpose: a `Purpose`; scripts may use integers of their own from 30 on.
    """
    low, high = seed % 2**32, seed % 2**64 >> 32  # as one number 7 * 2**32 + 5 would be (5, 7)
    sequence = np.random.SeedSequence([low, number, int(purpose), high])
    return Generator().manual_seed(int(sequence.generate_state(1, np.uint64)[0]) >> 1)
