"""Classifier-free guidance: hidden labels in training, two velocities in sampling."""

import pytest
import torch
from support import refused, seeded

from cotlearn.couplings import ConditionalOT, Pairs
from cotlearn.flows import Guided, LabelDropout, VelocityMLP, sampler
from cotlearn.flows.matching import conditional_flow_matching_loss
from cotlearn.mixtures import petals


def pairs(n=400):
    x1, c = petals().sample(n, generator=seeded())
    return ConditionalOT()(torch.randn(n, 2, generator=seeded(1)), x1, c, generator=seeded(2))


class Seen:
    """A velocity that remembers its conditions."""

    def __call__(self, t, x, c):
        self.c = c
        return torch.zeros_like(x)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_a_share_of_the_labels_is_hidden(share):
    network, batch = Seen(), pairs()
    kept = batch.c.clone()
    LabelDropout(share)(network, batch, seeded())
    hidden = (network.c == 0).all(dim=1)
    assert abs(float(hidden.float().mean()) - share) < 0.08
    assert torch.equal(network.c[~hidden], kept[~hidden])
    assert torch.equal(batch.c, kept)  # the pairs are not changed


def test_one_value_a_row():
    network, batch = VelocityMLP(2, 4, width=8, seed=0), pairs(50)
    assert LabelDropout(0.5)(network, batch, seeded()).shape == (50,)
    assert conditional_flow_matching_loss(network, batch, seeded()).shape == (50,)


@pytest.mark.parametrize(("scale", "expected"), [(0.0, 2.0), (1.0, 5.0), (2.0, 8.0)])
def test_the_scale_goes_from_without_to_with_and_on(scale, expected):
    def velocity(t, x, c):
        return torch.full_like(x, 2.0) + 3 * c.sum(dim=1, keepdim=True)

    c = torch.eye(4)
    assert torch.equal(Guided(velocity, scale)(0.0, torch.zeros(4, 2), c),
                       torch.full((4, 2), expected))  # fmt: skip


def test_it_can_be_sampled():
    guided = Guided(VelocityMLP(2, 4, width=8, seed=0), 1.5)
    assert sampler(guided, nfe=2)(torch.eye(4), generator=seeded()).shape == (4, 2)


test_bad_input = refused(
    (lambda: LabelDropout(1.5), ValueError, "share must lie in"),
    (lambda: LabelDropout(-0.1), ValueError, "share must be at least 0"),
    (lambda: Guided(Seen(), -1), ValueError, "scale must be at least 0"),
    (lambda: Guided(Seen(), 1)(0.0, torch.zeros(3, 2), None), TypeError, "needs a condition"),
)


@pytest.mark.parametrize("c", [torch.zeros(8, 2), torch.linspace(-1, 1, 8)[:, None]])
def test_a_condition_that_may_be_zero_is_named(c):
    """At 0 a network answered for all conditions."""
    x, rows = torch.zeros(8, 2), torch.arange(8)
    with pytest.warns(UserWarning, match="LabelDropout hides a condition by zeros"):
        LabelDropout(0.5)(lambda t, x, c: x, Pairs(x, x, c, rows, rows))


def test_a_velocity_may_return_the_same_buffer_each_time():
    out = torch.empty(4, 2)
    guided = Guided(lambda t, x, c: out.copy_(x + c.sum(dim=1, keepdim=True)), 3.0)
    assert torch.equal(guided(0.5, torch.zeros(4, 2), torch.eye(4)), torch.full((4, 2), 3.0))
