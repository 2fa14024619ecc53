"""Mixed precision and fused attention: losses, gradients and samples are those of plain ones."""

import pytest
import torch
from support import seeded
from torch import nn

from cotlearn.couplings import Independent
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.flows.diffusion import Diffusion, regression_loss
from cotlearn.flows.guidance import LabelDropout
from cotlearn.flows.matching import FlowMatching
from cotlearn.flows.one_step import MeanFlow, MeanVelocity, Shortcut, TwoPasses, jump
from cotlearn.mixtures import petals

PLAIN = [
    FlowMatching(0.2),
    FlowMatching(prediction="data", power=1.0),
    LabelDropout(),
    Diffusion().loss,
    regression_loss,
    TwoPasses(),
]
OF_JUMPS = [MeanFlow(), MeanFlow(uniform=True, prediction="data"), Shortcut(), Shortcut(1.0)]


def a_batch():
    x1, c = petals().sample(64, generator=seeded())
    return Independent()(torch.randn(64, 2, generator=seeded(1)), x1, c, seeded())


def a_network():
    return VelocityMLP(2, 4, seed=0)


def a_network_of_jumps():
    return MeanVelocity(VelocityMLP(2, 5, seed=0))


def trained(network, loss, pairs, *, half):
    """The loss of each row, and the gradient of their mean."""
    with torch.autocast("cpu", dtype=torch.bfloat16, enabled=half):
        rows = loss(network, pairs, seeded())
    gradient = torch.autograd.grad(rows.mean(), list(network.parameters()))
    return rows.detach(), torch.cat([part.flatten() for part in gradient])


@pytest.mark.parametrize(
    ("loss", "network"),
    [(loss, a_network) for loss in PLAIN] + [(loss, a_network_of_jumps) for loss in OF_JUMPS],
)
def test_a_loss_in_half_precision_is_the_loss(loss, network):
    network, pairs = network(), a_batch()
    rows, slope = trained(network, loss, pairs, half=False)
    rough, rough_slope = trained(network, loss, pairs, half=True)
    assert rough.dtype == torch.float32
    assert rough.mean() == pytest.approx(rows.mean().item(), rel=0.02, abs=1e-5)
    assert torch.cosine_similarity(slope, rough_slope, dim=0) > 0.95


def test_a_training_inside_autocast_trains_every_weight():
    losses = []
    for half in (False, True):
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=half):  # it keeps cast weights
            result = fit(
                a_network(), petals(), Independent(), steps=120, batch_size=128, progress=False
            )
        losses.append(result.history["loss"][-1])
    assert losses[1] == pytest.approx(losses[0], rel=0.02)


def test_samples_in_half_precision_have_the_type_of_the_noise():
    network, jumps, x0, c = a_network(), a_network_of_jumps(), a_batch().x0, a_batch().c
    with torch.autocast("cpu", dtype=torch.bfloat16):
        samples = {
            "flow": integrate(network, x0, c, nfe=4).x1,
            "jump": jump(jumps, x0, c, nfe=2),
            "ddim": Diffusion().ddim(network, x0, c, nfe=4),
            "two passes": TwoPasses().sample(network, x0, c),
        }
    assert {name: x.dtype for name, x in samples.items()} == dict.fromkeys(samples, x0.dtype)


class Attention(nn.Module):
    """A network whose rows are three tokens that see each other."""

    dim, condition_dim = 2, 1

    def __init__(self):
        super().__init__()
        self.first, self.last = nn.Linear(4, 24), nn.Linear(24, 2)

    def forward(self, t, x, c):
        time = torch.as_tensor(t, dtype=x.dtype).expand(len(x))[:, None]
        h = self.first(torch.cat([x, time, c], dim=1)).reshape(-1, 1, 3, 8)
        return self.last(nn.functional.scaled_dot_product_attention(h, h, h).flatten(1))


def test_a_mean_flow_of_a_network_with_attention():
    pairs = Independent()(*torch.randn(2, 64, 2, generator=seeded()))
    network = MeanVelocity(Attention())
    loss = MeanFlow(share_instant=0.0, uniform=True, power=0.0)(network, pairs, seeded())
    loss.mean().backward()
    assert loss.isfinite().all()
    assert network.network.first.weight.grad.norm() > 0
