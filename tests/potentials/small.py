"""A small potential, and pairs for it."""

import torch
from support import seeded

from cotlearn.couplings import Pairs
from cotlearn.potentials import ICNN, PICNN


def network(condition_dim=0):
    """Away from its start."""
    if condition_dim:
        net = PICNN(2, condition_dim, width=8, depth=2, condition_width=6, seed=0)
    else:
        net = ICNN(2, width=8, depth=2, seed=0)
    with torch.no_grad():
        net.body["raw_w"].add_(4.0)
    return net.double()


def make_pairs(n=64, condition_dim=0, order=None):
    """Row and row, or x1 in another order."""
    generator = seeded()
    x0 = torch.randn(n, 2, generator=generator).double()
    x1 = 2 * torch.randn(n, 2, generator=generator).double() + 1
    c = torch.rand(n, condition_dim, generator=generator).double() if condition_dim else None
    order = torch.arange(n) if order is None else order
    return Pairs(x0, x1[order], c, torch.arange(n), order)
