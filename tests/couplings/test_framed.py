"""Pairs in the frame of the condition: nothing is lost, and the prior stays where it was."""

import math

import pytest
import torch

from cotlearn.couplings import (
    ConditionalOT,
    Framed,
    Independent,
    MinibatchOT,
    ModelAligned,
    StratifiedOT,
)
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier, linear_skew, prior_skew
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


def test_data_keep_their_conditions():
    x1, c, pairs = pairs_of(framed(MinibatchOT()), n=500)
    assert torch.equal(pairs.c, c[pairs.target_index])
    assert torch.allclose(pairs.x1, x1[pairs.target_index], atol=1e-5)
    assert sorted(pairs.target_index.tolist()) == list(range(500))


def test_naive_ot_in_the_frame_does_not_skew_and_straightens_the_most():
    """Seen from the condition the data are the same for every c: there is nothing to know."""
    x1, c = DATA.sample(4000, generator=seeded())
    found = frontier(
        x1,
        c,
        {
            "independent": Independent(),
            "naive": MinibatchOT(),
            "in the frame": framed(MinibatchOT()),
        },
        rows=2048,
        progress=False,
    )
    assert found["naive"].flagged
    assert not found["in the frame"].flagged
    assert found["in the frame"].candidates == 256
    variance = {point.name: point.one_step_variance for point in found}
    assert variance["in the frame"] < 0.4 * variance["independent"]


@pytest.mark.parametrize("seed", range(3))
def test_the_noise_stays_standard_normal_and_blind(seed):
    *_, pairs = pairs_of(framed(MinibatchOT()), seed=10 * seed)
    assert pairs.x0.mean(dim=0).abs().max() < 0.06
    assert (pairs.x0.T.cov() - torch.eye(2)).abs().max() < 0.12
    assert prior_skew(pairs.x0, pairs.c).p_value > 1e-4
    assert linear_skew(pairs.x0, pairs.c, degree=2).p_value > 1e-4


@pytest.mark.parametrize("inner", [MinibatchOT(), ConditionalOT(3.0), StratifiedOT(8)], ids=repr)
def test_streams(inner):
    coupling = framed(inner)
    x1, c = DATA.sample(600, generator=seeded())
    data = Dataset(x1, c)

    def first(n, start=0):
        stream = coupling.stream(data, batch_size=100, generator=seeded(3), start=start)
        return [next(stream) for _ in range(n)]

    batches = first(6)
    for batch in batches:  # each row is one of the data, with its own condition
        distance = torch.cdist(rows_of(batch.x1, batch.c), rows_of(x1, c))
        assert distance.min(dim=1).values.max() < 1e-3
    assert torch.equal(first(2, start=4)[1].x0, batches[5].x0)  # resumed
    assert coupling.epoch_rows(data) == inner.epoch_rows(data)
    assert coupling.name == inner.name


def test_endless_data():
    stream = framed(MinibatchOT()).stream(DATA, batch_size=64, generator=seeded())
    batch = next(stream)
    seen = into(batch.x1, batch.c)
    assert seen[:, 1].abs().max() < 1.5  # four standard deviations of .25, and some
    assert len(batch) == 64


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
        (lambda: Framed("exact", into, out), TypeError, "coupling must be a Coupling"),
        (lambda: Framed(MinibatchOT(), None, out), TypeError, "into must be a function"),
        (lambda: Framed(MinibatchOT(), into, 3), TypeError, "out must be a function"),
        (lambda: framed(ModelAligned("weighted")), ValueError, "ask the network"),
        (lambda: framed(ConditionalOT(1.0, label="source")), ValueError, "source's label"),
        (lambda: framed(MinibatchOT())(X, X), TypeError, "needs the conditions c"),
        (lambda: framed(MinibatchOT())(X, X[:9], C), ValueError, "x1 has 9 rows"),
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
        (
            lambda: next(framed(StratifiedOT(2)).stream(DATA, batch_size=8)),
            TypeError,
            "endless",
        ),
    ],
)
def test_bad_input(call, error, message):
    with pytest.raises(error, match=message):
        call()
