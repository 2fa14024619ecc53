"""Velocity networks and an image encoder."""

import contextlib
import itertools
import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor, nn
from torch.overrides import TorchFunctionMode

from cotlearn.validation import check_count, check_seed

_TIME_SIZE = 32
ROUNDING = 1e-5  #: by which the sum of a solver's steps may leave [0, 1]
#: torch's functions, of tensors and of `nn.init`, that draw initial weights.
DRAWING = {"uniform_", "normal_", "kaiming_uniform_", "kaiming_normal_", "xavier_uniform_"}
DRAWING |= {"xavier_normal_", "trunc_normal_", "randn", "rand"}
_GROUPS = 8  #: of the group normalisation, as in Diffusion Policy


class _Network(nn.Module):
    """Base class of velocity networks: their sizes and the form of their inputs."""

    def __init__(self, dim: int, condition_dim: int) -> None:
        super().__init__()
        self.dim = check_count(dim, "dim")
        self.condition_dim = check_count(condition_dim, "condition_dim", minimum=0)

    def _inputs(self, t: Tensor | float, x: Tensor, c: Tensor | None) -> tuple[Tensor, Tensor]:
        """Return t as (B,) and c as (B, k), with k = 0 if there is no condition.

        Raises:
            ValueError: t or c has another shape, or a t on the CPU lies outside [0, 1].
        """
        time, k = torch.as_tensor(t, dtype=x.dtype, device=x.device), self.condition_dim
        if time.ndim > 1 or (time.ndim == 1 and len(time) != len(x)):
            given = tuple(time.shape)
            raise ValueError(f"t must be a number or have shape ({len(x)},), got {given}")
        if k and (c is None or c.shape != (len(x), k)):
            came = None if c is None else tuple(c.shape)
            raise ValueError(f"c must have shape ({len(x)}, {k}), got {came}")
        if not k and c is not None and c.numel():
            raise ValueError(f"c must be None: condition_dim is 0; got shape {tuple(c.shape)}")
        if time.is_cpu and not torch.compiler.is_compiling():  # of a GPU it would wait
            _check_range(time)
        return time.expand(len(x)), x[:, :0] if c is None else c.to(x.dtype)


def _check_range(time: Tensor) -> None:
    """Raise ValueError unless times, a number or (B,), lie in [0, 1]."""
    try:
        ends = time.detach().aminmax() if time.ndim else (time, time)
        low, high = (end.item() for end in ends)
    except RuntimeError:  # inside torch.func.vmap there are no numbers to look at, or no rows
        return
    if not (low >= -ROUNDING and high <= 1 + ROUNDING):
        raise ValueError(f"t must lie in [0, 1], got values from {low:.6g} to {high:.6g}")


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


def rebuilt(
    build: Callable[..., nn.Module], sizes: dict[str, Any], tensors: dict[str, Tensor]
) -> nn.Module:
    """A network of the sizes and the weights that a file names.

    A file can claim any size, but nothing is built that is larger than its weights.

    Args:
        build: makes the network of the sizes.
        sizes: arguments of `build`.
        tensors: the weights, by name.

    Raises:
        ValueError: the weights are not those of a network of these sizes.
    """
    deepest = max(int(sizes.get(name, 0)) for name in ("blocks", "depth"))
    if deepest > len(tensors):
        raise ValueError(f"{deepest} layers cannot have {len(tensors)} weights")
    with torch.device("meta"):  # without memory
        claimed = {name: value.shape for name, value in build(**sizes).state_dict().items()}
    if claimed != (held := {name: value.shape for name, value in tensors.items()}):
        name = next(name for name in claimed | held if claimed.get(name) != held.get(name))
        raise ValueError(f"{name} has the shape {held.get(name)}, expected {claimed.get(name)}")
    network = build(**sizes)
    network.load_state_dict(tensors)
    return network


def seeded(seed: int | None) -> contextlib.AbstractContextManager[Any]:
    """Draw the initial weights that are made in the block from this seed; None: from torch's.

    torch's global randomness is not touched, so that other threads neither change the weights nor
    are changed by them.
    """
    return contextlib.nullcontext() if seed is None else _Seeded(seed)


class _Seeded(TorchFunctionMode):
    """Gives the functions by which torch draws initial weights a generator; for one thread."""

    def __init__(self, seed: int) -> None:
        super().__init__()
        self._seed = check_seed(seed)
        self._generators: dict[torch.device, torch.Generator] = {}

    def __torch_function__(
        self, function: Any, types: Any, args: Any = (), kwargs: Any = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        if getattr(function, "__name__", "") in DRAWING:
            first = args[0] if args else kwargs.get("tensor")
            device = first.device if isinstance(first, Tensor) else torch.get_default_device()
            if device not in self._generators:
                self._generators[device] = torch.Generator(device).manual_seed(self._seed)
            kwargs["generator"] = self._generators[device]
        return function(*args, **kwargs)
