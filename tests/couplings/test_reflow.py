"""Reflow: the pairs are the teacher's."""

import pytest
import torch
from support import refused, same, seeded, take

from cotlearn.couplings import FixedPairs, Reflow
from cotlearn.datasets import Dataset
from cotlearn.flows import VelocityMLP, conditional_flow_matching_loss, integrate
from cotlearn.mixtures import petals


def batch(n=16):
    x1, c = petals().sample(n, generator=seeded())
    return torch.randn(n, 2, generator=seeded(1)), x1, c


def test_noise_meets_what_the_teacher_makes_of_it():
    x0, x1, c = batch()
    network = VelocityMLP(2, 4, width=8, depth=1, seed=0)
    pairs = Reflow(lambda x0, c: integrate(network, x0, c, nfe=4).x1)(x0, x1, c)
    assert torch.equal(pairs.x1, integrate(network, x0, c, nfe=4).x1)
    assert torch.equal(pairs.x0, x0)
    assert torch.equal(pairs.c, c)
    assert not pairs.x1.requires_grad
    assert not torch.equal(pairs.x1, x1)


def test_a_student_that_knows_the_map_has_no_loss():
    """x1 = x0 + a(c) is a straight flow with velocity a(c): nothing is left to learn."""

    def shift(c):
        return c @ torch.tensor([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])

    pairs = Reflow(lambda x0, c: x0 + shift(c))(*batch())
    loss = conditional_flow_matching_loss(lambda t, x, c: shift(c), pairs, seeded())
    assert loss.max() < 1e-10


def test_without_a_condition():
    x0, x1, _ = batch()
    pairs = Reflow(lambda x0, c: 2 * x0)(x0, x1)
    assert torch.equal(pairs.x1, 2 * x0)
    assert pairs.c is None
    assert pairs.weight is None


def test_a_stream_of_pairs():
    coupling, sizes = Reflow(lambda x0, c: x0 + c[:, :2]), {"batch_size": 8, "ot_batch_size": 16}
    batches = take(coupling, petals(), 5, **sizes)
    for pairs in batches:
        assert len(pairs) == 8
        assert torch.equal(pairs.x1, pairs.x0 + pairs.c[:, :2])
    assert all(map(same, batches[3:], take(coupling, petals(), 2, start=3, **sizes)))


def test_rows_and_candidates():
    x0, x1, c = batch()
    coupling = Reflow(lambda x0, c: x0)
    pairs = coupling(x0, x1, c)
    assert torch.equal(pairs.source_index, torch.arange(16))
    assert torch.equal(pairs.target_index, torch.arange(16))
    assert coupling.candidates(x0, x1, c) == 1
    assert coupling.name == "reflow"
    assert repr(coupling) == "Reflow()"  # not the teacher's address in memory


def test_fixed_pairs_keep_their_partners():
    x0, x1, c = torch.randn(40, 2), torch.randn(40, 3)[:, :2], torch.randn(40, 1)
    (pairs,) = take(FixedPairs(x0), Dataset(x1, c), 1)
    assert torch.equal(pairs.x0, x0[pairs.source_index])
    assert torch.equal(pairs.x1, x1[pairs.source_index])
    assert torch.equal(pairs.c, c[pairs.source_index])
    (plain,) = take(FixedPairs(x0), Dataset(x1), 1)
    assert plain.c is None
    assert torch.equal(plain.x0, x0[plain.source_index])


def taught(teacher):
    return Reflow(teacher)(*batch())


FIXED = FixedPairs(torch.randn(40, 2))
test_bad_input = refused(
    (
        lambda: taught(lambda x0, c: x0[:3]),
        ValueError,
        r"teacher.* must have shape \(16, 2\), got \(3, 2\)",
    ),
    (lambda: taught("teacher"), TypeError, "teacher must be a function"),
    (lambda: taught(lambda x0, c: x0 / 0), ValueError, "teacher.* has NaN or infinite values"),
    (lambda: taught(lambda x, c: x.tolist()), TypeError, "teacher.* floating-point tensor.* list"),
    (lambda: take(FIXED, Dataset(torch.zeros(30, 2)), 1), ValueError, "x0 has 40 rows"),
    (lambda: take(FIXED, petals(), 1), TypeError, "needs finite data"),
)


def test_fixed_pairs_take_no_other_noise():
    """They ignored their own, and returned what came."""
    z, x1, c = (torch.randn(8, 2, generator=seeded(k)) for k in range(3))
    pairs = FixedPairs(z)(z, x1, c)
    assert torch.equal(pairs.x0, z)
    assert torch.equal(pairs.x1, x1)
    for noise in (-z, z[:4]):
        with pytest.raises(ValueError, match="x0 must be the noise of these FixedPairs"):
            FixedPairs(z)(noise, x1[: len(noise)], c[: len(noise)])
    with pytest.raises(ValueError, match="source must be None: FixedPairs have noise of their own"):
        next(FixedPairs(z).stream(Dataset(x1, c), batch_size=4, source=torch.randn))


def test_fixed_pairs_keep_their_noise_when_a_buffer_is_refilled():
    x0, x1 = torch.randn(8, 2, generator=seeded()), torch.randn(8, 2, generator=seeded(1))
    coupling, before = FixedPairs(x0), x0.clone()
    x0.zero_()
    assert torch.equal(coupling(before, x1).x0, before)


def test_a_teacher_may_return_the_same_buffer_each_time():
    out = torch.empty(32, 2)
    coupling = Reflow(lambda x0, c: torch.mul(x0, 2, out=out))
    noise = torch.randn(2, 32, 2, generator=seeded())
    first, _ = (coupling(x0, torch.zeros(32, 2)) for x0 in noise)
    assert torch.equal(first.x1, 2 * first.x0)
