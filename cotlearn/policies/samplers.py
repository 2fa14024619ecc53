"""How a chunk is drawn from a network: samplers of flows, of diffusions, of regressions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from cotlearn.flows.diffusion import SPACINGS, Diffusion, predict
from cotlearn.flows.solvers import integrate


class Sampler:
    """Turns noise into chunks with a network. A new one overrides `name`, `nfe` and the call."""

    @property
    def draws(self) -> int:
        """Noise tensors that a chunk needs."""
        return 1

    @property
    def name(self) -> str:
        """For tables: "euler-16"."""
        raise NotImplementedError

    @property
    def nfe(self) -> int:
        """Evaluations of the network for a chunk."""
        raise NotImplementedError

    @property
    def variants(self) -> list[Sampler]:
        """The samplers that a comparison tries on the same network."""
        return [self]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (draws, B, d) under conditions c (B, k)."""
        raise NotImplementedError


@dataclass(frozen=True)
class FlowSampler(Sampler):
    """Integrates the network as a velocity field.

    Attributes:
        nfe: evaluations of the network for a chunk.
        method: a fixed-step method of `integrate`.
    """

    nfe: int = 16
    method: str = "euler"

    @property
    def name(self) -> str:
        """For tables: "euler-16"."""
        return f"{self.method}-{self.nfe}"

    @property
    def variants(self) -> list[Sampler]:
        """Euler's method with 1 to 16 evaluations, and one midpoint step."""
        return [*(FlowSampler(nfe) for nfe in (1, 2, 4, 16)), FlowSampler(2, "midpoint")]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        return integrate(network, noise[0], c, nfe=self.nfe, method=self.method).x1


@dataclass(frozen=True)
class DDPMSampler(Sampler):
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
        """One for each level."""
        return self.levels

    @property
    def name(self) -> str:
        """For tables: "ddpm-100"."""
        return f"ddpm-{self.levels}"

    @property
    def variants(self) -> list[Sampler]:
        """The chain itself, and DDIM with 4 and with 16 evaluations, in both spacings."""
        few = [DDIMSampler(n, self.levels, s, self.clip) for n in (4, 16) for s in SPACINGS]
        return [self, *few]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (levels, B, d) under conditions c (B, k)."""
        return Diffusion(self.levels, clip=self.clip).ddpm(network, noise[0], c, noise=noise[1:])


@dataclass(frozen=True)
class DDIMSampler(Sampler):
    """Few deterministic steps of a diffusion model."""

    nfe: int = 16
    levels: int = 100
    spacing: str = "leading"
    clip: float = 1.0

    @property
    def name(self) -> str:
        """For tables: "ddim-16", "ddim-4-trailing"."""
        return f"ddim-{self.nfe}" + ("" if self.spacing == "leading" else f"-{self.spacing}")

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        diffusion = Diffusion(self.levels, clip=self.clip)
        return diffusion.ddim(network, noise[0], c, nfe=self.nfe, spacing=self.spacing)


@dataclass(frozen=True)
class MeanSampler(Sampler):
    """The one chunk that a regression predicts; of the noise only the shape counts."""

    nfe = 1
    name = "mean"

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) under conditions c (B, k)."""
        with torch.no_grad():
            return predict(network, noise[0], c)


#: By the name that a saved policy has for them.
SAMPLERS: dict[str, Callable[..., Sampler]] = {
    kind.__name__: kind for kind in (FlowSampler, DDPMSampler, DDIMSampler, MeanSampler)
}
