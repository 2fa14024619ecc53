"""Networks that predict the mean velocity of a jump, so that one evaluation can cross all of it.

The mean velocity from time t to r >= t is u(x, t, r) = (x_r - x_t) / (r - t), along the path of
the flow that passes x at t.
"""

import inspect
import threading
from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn.attention import SDPBackend, sdpa_kernel

from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import (
    PREDICTIONS,
    Time,
    evaluate,
    interpolate,
    squared_error,
    velocity_of,
)
from cotlearn.validation import check_choice, check_count, check_number, check_sampled, check_share

#: Of log(t / (1 - t)), which has deviation 1. (The paper's -0.4 counts time from the data.)
LOCATION = 0.4
LEVELS = 7  #: of shortcuts, from 1 down to 1/64
#: torch has one level of forward derivatives for all threads: who leaves it takes those of others.
_FORWARD_MODE = threading.Lock()


class MeanVelocity(nn.Module):
    """A network of mean velocities u, called as u(t, x, c, length) with length = r - t.

    Without a length it is the velocity at time t, which `integrate` can use.

    Args:
        network: a velocity network; the length becomes the last column of its condition, so its
            `condition_dim` must be k + 1 for conditions of k columns.
    """

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network: Any = network
        self.dim, self.sizes = self.network.dim, getattr(network, "sizes", {})
        self.condition_dim = check_count(self.network.condition_dim, "condition_dim") - 1

    def forward(self, t: Tensor, x: Tensor, c: Tensor | None = None, length: Time = 0.0) -> Tensor:
        """The mean velocity (B, d) from t to t + length, each a number or of shape (B,)."""
        column = torch.as_tensor(length, dtype=x.dtype, device=x.device).expand(len(x))[:, None]
        return self.network(t, x, column if c is None else torch.cat([c.to(x), column], dim=1))


@dataclass(frozen=True)
class MeanFlow:
    """The loss of mean flows (Geng 2505.13447, eq. 10).

    Along a path, u = v + (r - t) du/dt. The derivative on the right is a forward-mode product of
    the network with the tangent (1, v, -1) of (t, x, r - t), where v = x1 - x0, and the right side
    is a fixed target. Where r = t this is flow matching; without such rows, errors proportional to
    1 / (r - t) satisfy the identity as well. Both times are drawn alike, and sorted.

    A row of squared error e has the weight 1 / (e + a)^power with a = 0.01, as in the code of the
    authors; their text suggests 0.001. The network is given the time t, counted from the noise, and
    the length r - t; the paper counts time from the data. With power 1 results depend on both
    choices and on the seed: on the petals at one evaluation the squared W2 is between 0.3 and 1.4
    (`benchmarks/mean_flow_choices.py`). Do not rank methods by such results.

    A network that predicts the data (as in Lu 2601.22158) answers x + (1 - t) u instead of u, and e
    is the squared error of that answer: (1 - t)^2 times that of u. Lu's loss is that of u itself.
    So ours weighs rows near the data less, and needs no limit on 1 / (1 - t).

    The defaults for times and share are those of the paper's ImageNet setting. Its CIFAR-10 setting
    has other times, and jumps on three quarters of the rows in the place of one.

    Args:
        share_instant: share of the rows with r = t, in [0, 1].
        power: 1, as in the paper for ImageNet; 0 for squared errors. Only with 0 is the best answer
            the mean: in few dimensions, where several answers are far apart, 1 prefers one of them.
        uniform: whether times are uniform in [0, 1], or logit-normal, as in the paper for ImageNet.
            Those hardly ever ask for the jump of a single evaluation, from 0 to 1.
        prediction: "velocity" or "data".
    """

    share_instant: float = 0.75
    power: float = 1.0
    uniform: bool = False
    prediction: str = "velocity"

    def __post_init__(self) -> None:
        check_share(self.share_instant, "share_instant")
        check_number(self.power, "power")
        check_choice(self.prediction, "prediction", PREDICTIONS)

    def __call__(self, network: MeanVelocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The weighted squared error of each row, (B,).

        Raises:
            TypeError: the network takes no length, or has a layer without forward-mode
                differentiation. (Attention by torch's `scaled_dot_product_attention` has it: the
                target uses its plain kernel.)
        """
        _check_takes_lengths(network)
        t, length = _starts_and_lengths(self, pairs, generator)
        x, v = interpolate(pairs.x0, pairs.x1, t), pairs.x1 - pairs.x0
        jumps = length > 0
        c = None if pairs.c is None else pairs.c[jumps]
        at, one = (t[jumps], x[jumps], length[jumps]), torch.ones_like(t[jumps])
        along, mean = (one, v[jumps], -one), cast(Any, velocity_of(network, self.prediction))
        try:
            # of rows that jump, for the target alone; fused attention has no such derivative
            with _FORWARD_MODE, torch.no_grad(), sdpa_kernel(SDPBackend.MATH):
                change = torch.func.jvp(lambda t, x, r: mean(t, x, c, r), at, along)[1]
        except (NotImplementedError, RuntimeError) as error:
            raise TypeError(f"network must allow forward-mode derivatives: {error}") from error
        target = v.index_put((jumps,), v[jumps] + length[jumps, None] * change)
        if self.prediction == "data":
            target = x + (1 - t[:, None]) * target
        return squared_error(network(t, x, pairs.c, length), target, self.power)


def _check_takes_lengths(network: Any) -> None:
    """Raise TypeError unless the network can be called as u(t, x, c, length)."""
    try:
        inspect.signature(getattr(network, "forward", network)).bind(*"txcl")
    except TypeError as error:
        kind = type(network).__name__
        wanted = "called as u(t, x, c, length), as MeanVelocity(network) is"
        raise TypeError(f"network must be {wanted}, got {kind}") from error


def _starts_and_lengths(
    loss: MeanFlow, pairs: Pairs, rng: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Sorted times t and r of each row as t and r - t, a share of them with r = t."""
    draw = torch.rand if loss.uniform else torch.randn
    times = draw(2, len(pairs), generator=rng).to(pairs.x0.device, _wide(pairs))
    if not loss.uniform:
        times = (times + LOCATION).sigmoid()
    t, r = times.amin(dim=0).to(pairs.x0), times.amax(dim=0).to(pairs.x0)
    instant = torch.rand(len(pairs), generator=rng).to(times) < loss.share_instant
    return t, (r - t).masked_fill(instant, 0.0)


def _wide(pairs: Pairs) -> torch.dtype:
    """The type to draw times in: half precision would round them up to 1."""
    return torch.promote_types(pairs.x0.dtype, torch.float32)


@dataclass(frozen=True)
class Shortcut:
    """The loss of shortcut models (Frans 2410.12557, eq. 5): a jump equals two jumps of half.

    The jump is 1, 1/2, ... or 1/64, and starts at a multiple of itself. The two halves are the
    target and get no gradient; the smallest halves have length 0. The other rows are flow matching
    with length 0.

    Args:
        share: share of the rows that learn jumps, in [0, 1].
    """

    share: float = 0.125

    def __post_init__(self) -> None:
        check_share(self.share, "share")

    def __call__(self, network: MeanVelocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The squared error of each row, (B,).

        Raises:
            TypeError: the network takes no length.
        """
        _check_takes_lengths(network)
        level = torch.randint(LEVELS, (len(pairs),), generator=generator)
        long = 0.5 ** level.to(pairs.x0.device, _wide(pairs))
        place, drawn = torch.rand(2, len(pairs), generator=generator).to(long).unbind()
        jumps = drawn < self.share
        t = torch.where(jumps, (place / long).floor() * long, place).to(pairs.x0)
        long = long.to(pairs.x0)
        length = long.masked_fill(~jumps, 0.0)
        x, target = interpolate(pairs.x0, pairs.x1, t), pairs.x1 - pairs.x0
        if jumps.any():
            with torch.no_grad():
                half = long[jumps] / 2
                said = half.masked_fill(level.to(jumps.device)[jumps] == LEVELS - 1, 0.0)
                c = None if pairs.c is None else pairs.c[jumps]
                first = network(t[jumps], x[jumps], c, said).clone()  # the next may overwrite it
                second = network(t[jumps] + half, x[jumps] + half[:, None] * first, c, said)
            target = target.index_put((jumps,), ((first + second) / 2).to(target))  # autocast
        return squared_error(network(t, x, pairs.c, length), target)


@torch.no_grad()
def jump(
    network: MeanVelocity,
    x0: Tensor,
    c: Tensor | None = None,
    *,
    nfe: int,
    prediction: str = "velocity",
) -> Tensor:
    """Samples (B, d) by nfe equal jumps from noise.

    Args:
        network: trained with `MeanFlow` or `Shortcut`.
        x0: (B, d) noise.
        c: (B, k), or None.
        nfe: evaluations of the network.
        prediction: of the network, see `MeanFlow`.

    Raises:
        TypeError: the network is not a `MeanVelocity`.
    """
    if not isinstance(network, MeanVelocity):
        raise TypeError(f"network must be a MeanVelocity, got {type(network).__name__}")
    c, x = check_sampled(network, x0, c), x0
    mean: Any = velocity_of(network, prediction)
    for step in range(check_count(nfe, "nfe")):
        x = x + evaluate(mean, step / nfe, x, c, 1 / nfe, name="network") / nfe
    return x
