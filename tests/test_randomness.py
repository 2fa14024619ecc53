"""Random streams: named, independent, and the same on every machine."""

import itertools

import torch

from cotlearn.randomness import Purpose, generator_for


def test_generators_differ_by_seed_number_and_purpose():
    seeds = 0, 1, 5, 5 + 7 * 2**32, 2**40, -1
    purposes = Purpose.ROWS, Purpose.LOSS
    drawn = {
        float(torch.rand(1, generator=generator_for(*key)))
        for key in itertools.product(seeds, (0, 1, 5, 7), purposes)
    }
    assert len(drawn) == 6 * 4 * 2


def test_a_stream_is_the_same_everywhere():
    assert generator_for(3, 7, Purpose.LOSS).initial_seed() == generator_for(3, 7, 1).initial_seed()
    assert generator_for(0, 0).initial_seed() == 7896617691693857887
    assert generator_for(3, 7, Purpose.ROLLOUT).initial_seed() == 5043753151369105969
