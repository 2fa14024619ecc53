"""Pairs in the frame of the condition: what is its own, beside test_wrapped.py."""

import math

import pytest
import torch

from cotlearn.couplings import (
    ConditionalOT,
    Framed,
    Independent,
    MinibatchOT,
)
from cotlearn.mixtures import rotating_pair

DATA = rotating_pair()  # both modes lie in the direction of the angle pi/2 c


def seeded(seed=0):
    return torch.Generator().manual_seed(seed)


def rotated(x, angle):
    cos, sin = angle[:, 0].cos(), angle[:, 0].sin()
    return torch.stack([cos * x[:, 0] - sin * x[:, 1], sin * x[:, 0] + cos * x[:, 1]], dim=1)


def into(x, c):
    return rotated(x, -math.pi / 2 * c)


def out(x, c):
    return rotated(x, math.pi / 2 * c)


def rows_of(x1, c):
    return torch.cat([x1, c], dim=1).double()


def framed(coupling):
    return Framed(coupling, into, out)


def pairs_of(coupling, n=4096, seed=0):
    x1, c = DATA.sample(n, generator=seeded(seed))
    return x1, c, coupling(torch.randn(n, 2, generator=seeded(seed + 1)), x1, c, seeded(seed + 2))


def test_a_turn_by_nothing_changes_nothing():
    still = Framed(ConditionalOT(2.0), lambda x, c: x, lambda x, c: x)
    _, _, one = pairs_of(still, n=300)
    _, _, two = pairs_of(ConditionalOT(2.0), n=300)
    assert torch.equal(one.x0, two.x0)
    assert torch.equal(one.x1, two.x1)


def test_its_words_name_what_is_inside():
    assert repr(framed(ConditionalOT(2.0))).startswith("Framed(ConditionalOT(condition_weight=2.0")
    assert "into, out" in repr(framed(Independent()))


X, C = torch.randn(20, 2), torch.randn(20, 1)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda: Framed(MinibatchOT(), None, out), TypeError, "into must be a function"),
        (lambda: Framed(MinibatchOT(), into, 3), TypeError, "out must be a function"),
        (
            lambda: Framed(MinibatchOT(), lambda x, c: 2 * x, out)(X, X, C),
            ValueError,
            "into must keep the length",
        ),
        (
            lambda: Framed(MinibatchOT(), into, lambda x, c: x + 1)(X, X, C),
            ValueError,
            "out must keep the length",
        ),
        (
            lambda: Framed(MinibatchOT(), lambda x, c: x[:, :1], out)(X, X, C),
            ValueError,
            r"into must return finite values of shape \(20, 2\), got \(20, 1\)",
        ),
        (
            lambda: Framed(MinibatchOT(), lambda x, c: x / 0, out)(X, X, C),
            ValueError,
            "into must return finite",
        ),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call()
