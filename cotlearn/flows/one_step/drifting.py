"""Drifting: samples that are trained to move towards the data and away from each other."""

from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Velocity, evaluate, squared_error
from cotlearn.validation import check_sampled

DIRECT = "donot_use_mm_for_euclid_dist"  #: a matrix product would lose digits
TEMPERATURES = (0.02, 0.05, 0.2)  #: of the kernel, in units of the mean distance to the data


@dataclass(frozen=True)
class Drifting:
    """The loss of drifting models (Deng 2602.04770): |y - (y + V)|^2 with a fixed target y + V.

    A network makes one sample y = network(0, x0, c) for each row. Rows of one *group* have the same
    condition, or conditions that are near: their data and their samples are compared with each
    other, and with no other group's. V, see `drift`, pulls a sample to the data of its group and
    pushes it from the group's other samples.

    Groups are those of the pairs if they have any (`StratifiedBatches`, for continuous conditions),
    else the rows with equal conditions; without conditions all rows are one. A row that is alone in
    its group does not drift. It does not matter which noise row is paired with which data row of
    its group, so couplings change nothing.

    V is normalised, so the value of the loss hardly falls while samples improve: do not judge a
    training by it, and let the learning rate fall to 0.
    """

    def __call__(self, network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """|V|^2 of each row, (B,), whose gradient moves the samples along V.

        Raises:
            ValueError: most rows are alone in their groups.
        """
        y = network(pairs.x0.new_zeros(()), pairs.x0, pairs.c)
        with torch.no_grad(), torch.autocast(y.device.type, enabled=False):
            target = y.to(pairs.x1, copy=True)  # distances need more digits than half precision has
            for rows in _groups(pairs):
                target[rows] += drift(target[rows], pairs.x1[rows])
        return squared_error(y, target)

    @torch.no_grad()
    def sample(self, network: Velocity, x0: Tensor, c: Tensor | None = None) -> Tensor:
        """Samples (B, d) from noise x0 (B, d) by one evaluation."""
        c = check_sampled(network, x0, c)
        return evaluate(network, x0.new_zeros(()), x0, c, name="network")


def drift(y: Tensor, data: Tensor) -> Tensor:
    """V (m, d) of m samples y of one group, for n rows of its data (Deng 2602.04770, algorithm 2).

    With k(a, b) = exp(-|a - b| / (tau s)), where s is the mean distance of samples and data, and
    with z the data and the *other* samples,

        A(y, z) = sqrt(softmax over z of log k * softmax over y of log k),
        V(y) = sum over data x and other samples y' of A(y, x) A(y, y') (x - y'),

    divided by its root mean square over rows and columns. V is the sum over the temperatures tau,
    times s / sqrt(d): the scale of the data, whatever their units.

    Fixed point: let y have density q, data p, and m and n grow. Then A(y, z) = k(y, z) / r(y) h(z)
    with h the same function for data and samples, and V(y) is proportional to

        integral of k(y, x) k(y, y') / (h(x) h(y')) (x - y') p(x) q(y') dx dy'.

    Exchanging the names of x and y' changes its sign if p = q, so V = 0: data and samples pull
    equally. In a finite group V = 0 holds on average, up to O(1 / m): the softmax over y has m
    terms for data, and m - 1 for a sample, which is not compared with itself.

    Args:
        y: (m, d) samples; a single one has no other to be compared with, and V = 0.
        data: (n, d).
    """
    if len(y) < 2:
        return torch.zeros_like(y)
    centre = data.mean(dim=0)  # V does not change with it, and digits are lost far from 0
    y, data = y - centre, data - centre
    to_data, to_others = (torch.cdist(y, z, compute_mode=DIRECT) for z in (data, y))
    to_others.fill_diagonal_(torch.inf)
    scale = to_data.mean().clamp(min=torch.finfo(y.dtype).tiny)
    temperatures = y.new_tensor(TEMPERATURES)[:, None, None]
    logits = torch.cat([to_data, to_others], dim=1) / (-temperatures * scale)
    share = ((logits.log_softmax(dim=2) + logits.log_softmax(dim=1)) / 2).exp()
    pull, push = share.split([len(data), len(y)], dim=2)
    v = push.sum(dim=2, keepdim=True) * (pull @ data) - pull.sum(dim=2, keepdim=True) * (push @ y)
    v = v / v.square().mean(dim=(1, 2), keepdim=True).sqrt().clamp(min=1e-12 * scale)
    return v.sum(dim=0) * scale / y.shape[1] ** 0.5


def _groups(pairs: Pairs) -> tuple[Tensor, ...]:
    """The rows of each group."""
    told = pairs.c if pairs.group is None else pairs.group
    told = pairs.x0.new_zeros(len(pairs)) if told is None else told
    _, label, sizes = torch.unique(told, dim=0, return_inverse=True, return_counts=True)
    if 2 * int((sizes == 1).sum()) > len(pairs):
        raise ValueError(
            f"c must have equal rows, but most of the {len(pairs)} in this batch are alone: take "
            "batches of near conditions from StratifiedBatches()"
        )
    return label.argsort(stable=True).split(sizes.tolist())
