"""torchcfm's matchers and flow_matching's paths with paired noise."""

import pytest
import torch
from peers import peer
from support import seeded

from cotlearn.bridge import PairedMatcher, PairedNoise, PairedPath, paired_noise
from cotlearn.couplings import ConditionalOT, MinibatchOT
from cotlearn.flows import VelocityMLP, integrate


class Straight:
    """What a matcher and a path do on straight paths, in the words of both packages."""

    def sample_location_and_conditional_flow(self, x0, x1, t=None, return_noise=False):
        return (t, x0, x1, "noise") if return_noise else (t, x0, x1)

    def sample(self, x_0, x_1, t):
        return x_0, x_1, t


IMAGES = torch.rand(12, 1, 4, 4, generator=seeded())
LABELS = torch.arange(12) % 3
NOISE = torch.randn(12, 1, 4, 4, generator=seeded(1))


def expected():
    return paired_noise(ConditionalOT(), IMAGES, LABELS, generator=seeded(2), noise=NOISE)


def pairing():
    return PairedNoise(ConditionalOT(), generator=seeded(2))


def test_a_matcher_gets_paired_noise_and_labels_stay():
    matcher, t = PairedMatcher(Straight(), pairing()), torch.rand(12)
    sample = matcher.guided_sample_location_and_conditional_flow
    drawn, x0, x1, y0, y1 = sample(NOISE, IMAGES, y1=LABELS, t=t)
    assert torch.equal(x0, expected())
    assert drawn is t
    assert x1 is IMAGES
    assert (y0, y1) == (None, LABELS)
    assert sample(NOISE, IMAGES, y1=LABELS, return_noise=True)[-1] == "noise"
    with pytest.raises(ValueError, match="y0 must be None"):
        sample(NOISE, IMAGES, y0=LABELS, y1=LABELS)


def test_a_path_gets_paired_noise():
    t = torch.rand(12)
    x_0, x_1, drawn = PairedPath(Straight(), pairing()).sample(NOISE, IMAGES, t, LABELS)
    assert torch.equal(x_0, expected())
    assert x_1 is IMAGES
    assert drawn is t


def test_a_matcher_that_pairs_is_refused():
    matcher = Straight()
    matcher.ot_sampler = None
    with pytest.raises(ValueError, match="matcher pairs by itself"):
        PairedMatcher(matcher, MinibatchOT())


def test_torchcfm_itself():
    matching = peer("torchcfm.conditional_flow_matching")
    matcher = PairedMatcher(matching.ConditionalFlowMatcher(sigma=0.0), pairing())
    sample = matcher.guided_sample_location_and_conditional_flow
    t, x_t, u_t, _, y1 = sample(NOISE, IMAGES, y1=LABELS)
    assert torch.allclose(x_t - t[:, None, None, None] * u_t, expected(), atol=1e-6)
    assert torch.allclose(u_t, IMAGES - expected())
    assert y1 is LABELS
    with pytest.raises(ValueError, match="give ConditionalFlowMatcher, not ExactOptimalTransport"):
        PairedMatcher(matching.ExactOptimalTransportConditionalFlowMatcher(), ConditionalOT())


@pytest.mark.slow
def test_torchcfms_network_learns_from_paired_noise_and_integer_labels():
    matching, unet = peer("torchcfm.conditional_flow_matching"), peer("torchcfm.models.unet")
    torch.manual_seed(0)
    options = {"num_channels": 32, "num_res_blocks": 1, "channel_mult": (1, 2)}
    network = unet.UNetModel((1, 8, 8), **options, class_cond=True, num_classes=3)
    images, optimizer = torch.rand(12, 1, 8, 8), torch.optim.Adam(network.parameters(), 1e-3)
    matcher = PairedMatcher(matching.ConditionalFlowMatcher(sigma=0.0), pairing())
    before, losses = network.label_emb.weight.detach().clone(), []
    for _ in range(3):
        sample = matcher.guided_sample_location_and_conditional_flow
        t, x_t, u_t, _, y = sample(torch.randn_like(images), images, y1=LABELS)
        loss = (network(t, x_t, y) - u_t).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[2] < losses[0]
    assert (network.label_emb.weight != before).any(dim=1).all()  # labels 0, 1 and 2 were seen


def test_flow_matching_itself_and_its_sampler_is_ours():
    peer("flow_matching")
    from flow_matching.path import CondOTProbPath
    from flow_matching.solver import ODESolver

    t = torch.rand(12, generator=seeded(3))
    found = PairedPath(CondOTProbPath(), pairing()).sample(NOISE, IMAGES, t, LABELS)
    assert torch.allclose(found.dx_t, IMAGES - expected())
    network, x0, c = VelocityMLP(2, 4, seed=0), torch.randn(64, 2), torch.eye(4).repeat(16, 1)
    theirs = ODESolver(lambda x, t, c: network(t, x, c)).sample(
        x_init=x0, method="euler", step_size=1 / 4, c=c
    )
    assert torch.equal(theirs, integrate(network, x0, c, nfe=4).x1)
