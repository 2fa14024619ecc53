"""Receding-horizon policies: see a short history, draw a chunk of actions, do half of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from cotlearn.flows.diffusion import Diffusion, predict
from cotlearn.flows.networks import ResidualMLP, TemporalUNet
from cotlearn.flows.solvers import integrate
from cotlearn.policies.camera import CameraNetwork
from cotlearn.policies.windows import Windows
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.task import Array
from cotlearn.storage import load_tensors, save_tensors
from cotlearn.validation import check_count

_FITTED = "fitted."  #: before the names of a coupling's tensors in a file


@dataclass(frozen=True)
class FlowSampler:
    """Integrates the network as a velocity field.

    Attributes:
        nfe: evaluations of the network for a chunk.
        method: a fixed-step method of `integrate`.
    """

    nfe: int = 16
    method: str = "euler"

    draws = 1  #: noise tensors that a chunk needs

    @property
    def name(self) -> str:
        """For tables: "euler-16"."""
        return f"{self.method}-{self.nfe}"

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        return integrate(network, noise[0], c, nfe=self.nfe, method=self.method).x1


@dataclass(frozen=True)
class DDPMSampler:
    """The ancestral chain of a diffusion model, one evaluation for each level.

    Attributes:
        levels: of noise.
        clip: largest value of a chunk, as the network sees it (see `Diffusion`).
    """

    levels: int = 100
    clip: float = 1.0

    @property
    def draws(self) -> int:
        """The start, and fresh noise in every step but the last."""
        return self.levels

    @property
    def nfe(self) -> int:
        """Evaluations of the network for a chunk."""
        return self.levels

    @property
    def name(self) -> str:
        """For tables: "ddpm-100"."""
        return f"ddpm-{self.levels}"

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (levels, B, d) under conditions c (B, k)."""
        return Diffusion(self.levels, clip=self.clip).ddpm(network, noise[0], c, noise=noise[1:])


@dataclass(frozen=True)
class DDIMSampler:
    """Few deterministic steps of a diffusion model."""

    nfe: int = 16
    levels: int = 100
    spacing: str = "leading"
    clip: float = 1.0

    draws = 1

    @property
    def name(self) -> str:
        """For tables: "ddim-16", "ddim-4-trailing"."""
        return f"ddim-{self.nfe}" + ("" if self.spacing == "leading" else f"-{self.spacing}")

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        return Diffusion(self.levels, clip=self.clip).ddim(
            network, noise[0], c, nfe=self.nfe, spacing=self.spacing
        )


@dataclass(frozen=True)
class MeanSampler:
    """Behaviour cloning by regression: the one chunk that the network predicts."""

    draws = 1  #: of which only the shape counts
    nfe = 1
    name = "mean"

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) under conditions c (B, k)."""
        with torch.no_grad():
            return predict(network, noise[0], c)


Sampler = FlowSampler | DDPMSampler | DDIMSampler | MeanSampler
_SAMPLERS: dict[str, Callable[..., Sampler]] = {
    kind.__name__: kind for kind in (FlowSampler, DDPMSampler, DDIMSampler, MeanSampler)
}


class ChunkPolicy:
    """A policy that acts in chunks.

    Args:
        network: network(t, x, c) with the sizes of `windows`.
        windows: frame, horizons and scale.
        sampler: how a chunk is drawn from the network.
        execute: steps of a chunk that are done before the next is drawn.
        fitted: what the coupling of its training had fitted (`state_dict` of its condition), to be
            kept with the weights; a policy does not need it to act.

    Raises:
        ValueError: the network's sizes or `execute` do not fit the windows.
    """

    def __init__(
        self,
        network: nn.Module,
        windows: Windows,
        sampler: Sampler,
        *,
        execute: int = 8,
        fitted: dict[str, Tensor] | None = None,
    ) -> None:
        for name in ("dim", "condition_dim"):
            got, expected = getattr(network, name, None), getattr(windows, name)
            if got != expected:
                raise ValueError(
                    f"network has {name} {got}, but windows of {windows.observe} observed and "
                    f"{windows.predict} predicted steps need {expected}"
                )
        if check_count(execute, "execute") > windows.predict:
            raise ValueError(
                f"execute must be at most the {windows.predict} predicted steps, got {execute}"
            )
        self.network, self.windows = network.eval(), windows
        self.sampler, self.execute = sampler, execute
        self.fitted = {} if fitted is None else fitted

    def with_sampler(self, sampler: Sampler) -> ChunkPolicy:
        """The same network, drawn from in another way."""
        return ChunkPolicy(
            self.network, self.windows, sampler, execute=self.execute, fitted=self.fitted
        )

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """What `act` needs for n rows, (draws, n, d).

        The first draw is the same for every sampler, so that policies can be compared on it.
        """
        return torch.randn(self.sampler.draws, n, self.windows.dim, generator=generator)

    @torch.no_grad()
    def draw(self, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d), as the network sees them, from noise (draws, B, d) under conditions c.

        A network with a camera looks once, whatever the number of evaluations.

        Raises:
            ValueError: noise and conditions do not fit each other or the policy.
        """
        expected = (self.sampler.draws, *c.shape[:1], self.windows.dim)
        if noise.shape != expected:
            raise ValueError(f"noise must have shape {expected}, got {tuple(noise.shape)}")
        if isinstance(self.network, CameraNetwork):
            return self.sampler(self.network.head, noise, self.network.encode(c))
        return self.sampler(self.network, noise, c)

    def chunk(
        self,
        history: ArrayLike,
        *,
        noise: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Array:
        """Draws chunks (B, predict, A) of actions, cut to the limits of the task.

        Args:
            history: (B, observe, columns), the last states, the present one last.
            noise: (draws, B, d), as `noise` gives it; fresh if None.
            generator: of fresh noise.

        Raises:
            ValueError: the history or the noise does not fit the policy.
            RuntimeError: the network's output is not finite.
        """
        history = self.windows.check_history(history)
        if noise is None:
            noise = self.noise(len(history), generator)
        x = self.draw(noise, self.windows.condition(history))
        actions = self.windows.actions(x, history)
        if not np.isfinite(actions).all():
            raise RuntimeError("the policy's actions are not finite: the training went wrong")
        return actions.clip(*self.windows.task.action_limits)

    def act(
        self,
        history: ArrayLike,
        *,
        noise: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> Array:
        """The actions (B, execute, A) to do next; arguments as for `chunk`."""
        return self.chunk(history, noise=noise, generator=generator)[:, : self.execute]

    def latency(self, *, batch: int = 1, repetitions: int = 30) -> float:
        """The median of the seconds that a chunk takes, from states to actions."""
        check_count(repetitions, "repetitions")
        generator = torch.Generator().manual_seed(0)
        state = self.windows.task.vector_sim(range(check_count(batch, "batch"))).states
        history = np.repeat(state[:, None], self.windows.observe, axis=1)
        seconds = []
        for _ in range(repetitions + 2):
            started = time.perf_counter()
            self.act(history, generator=generator)
            seconds.append(time.perf_counter() - started)
        return float(np.median(seconds[2:]))  # the first two warm up

    def save(
        self, path: str | Path, *, half: bool = False, about: dict[str, Any] | None = None
    ) -> None:
        """Writes network, windows and sampler as safetensors.

        Args:
            path: the file.
            half: in 16 bits, which halves the file.
            about: more to remember, JSON-compatible.
        """
        everything = self.network.state_dict()
        everything |= {f"{_FITTED}{name}": value for name, value in self.fitted.items()}
        tensors = {
            name: value.half() if half and value.is_floating_point() else value
            for name, value in everything.items()
        }
        record = {
            "policy": {
                "network": _sizes(self.network),
                "windows": self.windows.about(),
                "sampler": {"kind": type(self.sampler).__name__, **asdict(self.sampler)},
                "execute": self.execute,
            },
            "about": about or {},
        }
        save_tensors(path, tensors, record)

    @classmethod
    def load(cls, path: str | Path) -> ChunkPolicy:
        """Reads what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged or holds no policy.
        """
        return cls.load_with_about(path)[0]

    @classmethod
    def load_with_about(cls, path: str | Path) -> tuple[ChunkPolicy, dict[str, Any]]:
        """Like `load`, together with what `save` was told to remember."""
        tensors, record = load_tensors(path)
        try:
            stored = record["policy"]
            network = build(**stored["network"])
            tensors = {name: value.float() for name, value in tensors.items()}
            fitted = {n: tensors.pop(n) for n in list(tensors) if n.startswith(_FITTED)}
            network.load_state_dict(tensors)
            sampler = dict(stored["sampler"])
            policy = cls(
                network.requires_grad_(False),
                Windows.from_about(stored["windows"]),
                _SAMPLERS[sampler.pop("kind")](**sampler),
                execute=stored["execute"],
                fitted={name.removeprefix(_FITTED): value for name, value in fitted.items()},
            )
            return policy, dict(record["about"])
        except (KeyError, TypeError, RuntimeError) as error:
            raise ValueError(f"{path} holds no policy that fits: {error}") from error


def build(kind: str, **sizes: Any) -> nn.Module:
    """A network by the name of its class and its sizes.

    Raises:
        ValueError: an unknown kind.
    """
    if kind == "ResidualMLP":
        return ResidualMLP(**sizes)
    if kind == "TemporalUNet":
        return TemporalUNet(**{**sizes, "widths": tuple(sizes["widths"])})
    if kind == "CameraNetwork":
        return CameraNetwork(**{**sizes, "camera": Camera(**sizes["camera"])})
    raise ValueError(f"kind must be ResidualMLP, TemporalUNet or CameraNetwork, got {kind!r}")


def _sizes(network: nn.Module) -> dict[str, Any]:
    """What `build` needs to make such a network."""
    kind = type(network).__name__
    if isinstance(network, ResidualMLP):
        first = network.first
        return {
            "kind": kind,
            "dim": network.dim,
            "condition_dim": network.condition_dim,
            "width": first.out_features,
            "blocks": len(network.blocks),
            "context": network.context[0].out_features,
        }
    if isinstance(network, TemporalUNet):
        return {
            "kind": kind,
            "steps": network.steps,
            "channels": network.channels,
            "condition_dim": network.condition_dim,
            "widths": network.widths,
            "kernel": network.kernel,
            "context": network.context[0].out_features,
        }
    if isinstance(network, CameraNetwork):
        return {
            "kind": kind,
            "camera": asdict(network.camera),
            "dim": network.dim,
            "features": network.features,
            "width": network.head.inner.first.out_features,
            "blocks": len(network.head.inner.blocks),
        }
    raise TypeError(f"a ResidualMLP, TemporalUNet or CameraNetwork can be saved, got {kind}")
