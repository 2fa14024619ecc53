"""Velocity networks and an image encoder."""

import contextlib
import itertools
import math
from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.validation import check_count

_TIME_SIZE = 32
_GROUPS = 8  #: of the group normalisation, as in Diffusion Policy
_UPPER, _LOWER, _KERNEL = 64, 128, 5  #: of the U-Net: channels of its levels, length of its filters
_CONTEXT = 64  #: size of its embedding of time and condition


class _Network(nn.Module):
    """Base class of velocity networks: their sizes and the form of their inputs."""

    def __init__(self, dim: int, condition_dim: int) -> None:
        super().__init__()
        self.dim = check_count(dim, "dim")
        self.condition_dim = check_count(condition_dim, "condition_dim", minimum=0)

    def _inputs(self, t: Tensor | float, x: Tensor, c: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return t as (B,) and c as (B, k), with k = 0 if there is no condition."""
        time = torch.as_tensor(t, dtype=x.dtype, device=x.device).expand(len(x))
        return time, x[:, :0] if c is None else c.to(x.dtype)


class VelocityMLP(_Network):
    """A multilayer perceptron v(t, x, c).

    Args:
        dim: d, columns of x and of the velocity.
        condition_dim: k, columns of c; 0 for no condition (c is then None).
        width: neurons of each hidden layer.
        depth: hidden layers.
        seed: of the initial weights; torch's global randomness if None.
    """

    def __init__(
        self,
        dim: int,
        condition_dim: int = 0,
        *,
        width: int = 128,
        depth: int = 3,
        seed: int | None = None,
    ) -> None:
        super().__init__(dim, condition_dim)
        check_count(width, "width")
        sizes = [1 + dim + condition_dim] + [width] * check_count(depth, "depth")
        with seeded(seed):
            hidden = ((nn.Linear(a, b), nn.SiLU()) for a, b in itertools.pairwise(sizes))
            self.layers = nn.Sequential(*itertools.chain(*hidden), nn.Linear(width, dim))

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The velocity, shape (B, d).

        Args:
            t: a number or shape (B,), in [0, 1].
            x: (B, d).
            c: (B, k), or None if the network has no condition.
        """
        time, condition = self._inputs(t, x, c)
        return self.layers(torch.cat([time[:, None], x, condition], dim=1))


class TimeFeatures(nn.Module):
    """Sines and cosines of t at `size` / 2 frequencies from pi/2 to 250 pi: (B,) -> (B, size).

    With t alone as input, a network can hardly tell neighbouring times apart, such as the 100 noise
    levels of a diffusion model.
    """

    frequencies: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        frequencies = math.pi / 2 * torch.logspace(0, math.log10(500), size // 2)
        self.register_buffer("frequencies", frequencies, persistent=False)

    def forward(self, t: Tensor) -> Tensor:
        """The features (B, size) of times t (B,)."""
        angle = t[:, None] * self.frequencies
        return torch.cat([angle.sin(), angle.cos()], dim=1)


class ResidualMLP(_Network):
    """A residual multilayer perceptron for larger problems, 1.3 million weights by default.

    Each block adds W2 silu(W1 norm(h) + U e) to h, where e is an embedding of time and condition.

    Args:
        dim: d, columns of x and of the velocity.
        condition_dim: k, columns of c; 0 for no condition (c is then None).
        width: neurons of each layer.
        blocks: residual blocks, two layers each.
        context: size of the embedding e.
        seed: of the initial weights; torch's global randomness if None.
    """

    def __init__(
        self,
        dim: int,
        condition_dim: int = 0,
        *,
        width: int = 384,
        blocks: int = 4,
        context: int = 64,
        seed: int | None = None,
    ) -> None:
        super().__init__(dim, condition_dim)
        check_count(width, "width")
        check_count(context, "context")
        check_count(blocks, "blocks")
        self.sizes: dict[str, Any] = {"dim": dim, "condition_dim": condition_dim, "width": width}
        self.sizes |= {"blocks": blocks, "context": context}  # to build it again from a file
        self.time = TimeFeatures(_TIME_SIZE)
        with seeded(seed):
            self.context = nn.Sequential(nn.Linear(_TIME_SIZE + condition_dim, context), nn.SiLU())
            self.first = nn.Linear(dim + condition_dim, width)
            self.blocks = nn.ModuleList(_ResidualBlock(width, context) for _ in range(blocks))
            self.last = nn.Sequential(nn.LayerNorm(width), nn.SiLU(), nn.Linear(width, dim))

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The velocity, shape (B, d); arguments as for `VelocityMLP`."""
        time, condition = self._inputs(t, x, c)
        context = self.context(torch.cat([self.time(time), condition], dim=1))
        h = self.first(torch.cat([x, condition], dim=1))
        for block in self.blocks:
            h = block(h, context)
        return self.last(h)


class _ResidualBlock(nn.Module):
    def __init__(self, width: int, context: int) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.first = nn.Linear(width, width)
        self.context = nn.Linear(context, width, bias=False)
        self.second = nn.Linear(width, width)

    def forward(self, h: Tensor, context: Tensor) -> Tensor:
        inner = self.first(self.norm(h)) + self.context(context)
        return h + self.second(nn.functional.silu(inner))


class TemporalUNet(_Network):
    """A 1D U-Net over the time steps of an action chunk, as in Diffusion Policy (2303.04137).

    x of shape (B, steps * channels) is reshaped to (B, steps, channels). Time and condition scale
    and shift the channels of every block (FiLM). The lower of the two levels has half the time
    steps.

    Args:
        steps: time steps of a chunk, even.
        channels: numbers at each time step.
        condition_dim: k, columns of c; 0 for no condition.
        seed: of the initial weights; torch's global randomness if None.
    """

    def __init__(
        self, steps: int, channels: int, condition_dim: int = 0, *, seed: int | None = None
    ) -> None:
        dim = check_count(steps, "steps") * check_count(channels, "channels")
        super().__init__(dim, condition_dim)
        if steps % 2:
            raise ValueError(f"steps must be a multiple of 2 for 2 levels, got {steps}")
        self.steps, self.channels = steps, channels
        self.sizes = {"steps": steps, "channels": channels, "condition_dim": condition_dim}
        self.time = TimeFeatures(_TIME_SIZE)
        with seeded(seed):
            self.context = nn.Sequential(nn.Linear(_TIME_SIZE + condition_dim, _CONTEXT), nn.Mish())
            self.upper = _FilmBlock(channels, _UPPER)
            self.lower = _FilmBlock(_UPPER, _LOWER)
            self.shorten = nn.Conv1d(_UPPER, _UPPER, 3, stride=2, padding=1)
            self.middle = _FilmBlock(_LOWER, _LOWER)
            self.lengthen = nn.ConvTranspose1d(_LOWER, _UPPER, 4, stride=2, padding=1)
            self.up = _FilmBlock(2 * _UPPER, _UPPER)
            self.last = nn.Conv1d(_UPPER, channels, 1)

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The velocity, shape (B, steps * channels); arguments as for `VelocityMLP`."""
        time, condition = self._inputs(t, x, c)
        context = self.context(torch.cat([self.time(time), condition], dim=1))
        h = x.reshape(len(x), self.steps, self.channels).transpose(1, 2)
        upper = self.upper(h, context)
        h = self.middle(self.lower(self.shorten(upper), context), context)
        h = self.up(torch.cat([self.lengthen(h), upper], dim=1), context)
        return self.last(h).transpose(1, 2).reshape(x.shape)


class _FilmBlock(nn.Module):
    """Two convolutions over time, scaled and shifted by the context, and a skip connection."""

    def __init__(self, before: int, after: int) -> None:
        super().__init__()
        self.first, self.second = _convolution(before, after), _convolution(after, after)
        self.film = nn.Linear(_CONTEXT, 2 * after)
        self.round = nn.Conv1d(before, after, 1) if before != after else nn.Identity()

    def forward(self, h: Tensor, context: Tensor) -> Tensor:
        scale, shift = self.film(context)[:, :, None].chunk(2, dim=1)
        return self.second((1 + scale) * self.first(h) + shift) + self.round(h)


def _convolution(before: int, after: int) -> nn.Sequential:
    filters = nn.Conv1d(before, after, _KERNEL, padding=_KERNEL // 2)
    return nn.Sequential(filters, nn.GroupNorm(_GROUPS, after), nn.Mish())


class SpatialSoftmax(nn.Module):
    """Spatial softmax: the mean position of each channel (Levine 1504.00702).

    A softmax turns each channel of (B, C, h, w) into a distribution over its cells. The result
    (B, 2 C) holds the mean x, then the mean y of all channels, from -1 to 1; it follows a feature
    with subpixel accuracy.
    """

    def forward(self, h: Tensor) -> Tensor:
        """The mean positions (B, 2 C) of h (B, C, h, w)."""
        share = h.flatten(2).softmax(dim=2).view(h.shape)
        y, x = (torch.linspace(-1, 1, n, dtype=h.dtype, device=h.device) for n in h.shape[2:])
        return torch.cat([share.sum(dim=2) @ x, share.sum(dim=3) @ y], dim=1)


class ImageEncoder(nn.Module):
    """Three convolutions with group normalisation and a spatial softmax, for small images.

    Args:
        features: size of the output.
        seed: of the initial weights; torch's global randomness if None.
    """

    def __init__(self, features: int, *, seed: int | None = None) -> None:
        super().__init__()
        self.features = check_count(features, "features")
        with seeded(seed):
            self.layers = nn.Sequential(
                *(nn.Conv2d(3, 16, 5, stride=2, padding=2), nn.GroupNorm(_GROUPS, 16), nn.ReLU()),
                *(nn.Conv2d(16, 32, 3, stride=2, padding=1), nn.GroupNorm(_GROUPS, 32), nn.ReLU()),
                *(nn.Conv2d(32, 64, 3, padding=1), nn.GroupNorm(_GROUPS, 64), nn.ReLU()),
                SpatialSoftmax(),
            )
            self.last = nn.Linear(2 * 64, features)

    def forward(self, images: Tensor) -> Tensor:
        """Encode images (B, 3, height, width), values from -1 to 1, as (B, features)."""
        return self.last(self.layers(images))


@contextlib.contextmanager
def seeded(seed: int | None) -> Iterator[None]:
    """Seed torch inside the block and restore its global randomness after; None: do nothing."""
    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(check_count(seed, "seed", minimum=0))
        yield
