"""How a chunk is drawn from a network: samplers of flows, of diffusions, of regressions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar, cast

import torch
from torch import Tensor, nn

from cotlearn.flows.diffusion import SPACINGS, Diffusion, predict
from cotlearn.flows.matching import PREDICTIONS, velocity_of
from cotlearn.flows.one_step import Drifting, MeanVelocity, TwoPasses, jump
from cotlearn.flows.solvers import FIXED, integrate
from cotlearn.validation import check_choice, check_count

MOST = 10_000  #: evaluations for a chunk, and levels of noise; a policy's file could name any


class Sampler:
    """Turns noise into chunks with a network. A new one overrides `method`, `nfe` and the call."""

    method: str  #: what a table calls it, before the number of evaluations
    random: ClassVar[bool] = True  #: whether samples depend on the noise
    family: ClassVar[str] = ""  #: of the training; empty: any

    @property
    def training(self) -> str:
        """The training that the network must have had: "flow, velocity"; empty: any."""
        return ", ".join(filter(None, (self.family, getattr(self, "prediction", ""))))

    @property
    def draws(self) -> int:
        """Noise tensors that a chunk needs."""
        return 1

    @property
    def name(self) -> str:
        """For tables: "euler-16"."""
        return f"{self.method}-{self.nfe}"

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
        method: a fixed-step method of `integrate`; "euler" or "midpoint" where the network
            predicts the data, which has no velocity at t = 1.
        prediction: of the network, see `FlowMatching`.
    """

    family = "flow"
    nfe: int = 16
    method: str = "euler"
    prediction: str = "velocity"

    def __post_init__(self) -> None:
        check_count(self.nfe, "nfe", most=MOST)
        exact = self.prediction == "data"
        check_choice(self.method, "method", ("euler", "midpoint") if exact else FIXED)

    @property
    def variants(self) -> list[Sampler]:
        """Euler's method with 1 to 16 evaluations, and one midpoint step."""
        euler = [replace(self, nfe=nfe, method="euler") for nfe in (1, 2, 4, 16)]
        return [*euler, replace(self, nfe=2, method="midpoint")]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        velocity = velocity_of(network, self.prediction)
        return integrate(velocity, noise[0], c, nfe=self.nfe, method=self.method).x1


def diffusion_of(prediction: str, levels: int = 100, clip: float | None = None) -> Diffusion:
    """The diffusion model of a prediction: with zero terminal SNR where that can be sampled."""
    exact = prediction != "noise"
    return Diffusion(levels, clip=clip, prediction=prediction, zero_terminal_snr=exact)


@dataclass(frozen=True)
class DDPMSampler(Sampler):
    """The ancestral chain of a diffusion model, one evaluation for each level.

    Attributes:
        levels: of noise.
        clip: largest value of a chunk, as the network sees it (see `Diffusion`).
        prediction: of the network, see `Diffusion`; unless it is the noise, with zero terminal SNR.
    """

    method = "ddpm"
    family = "diffusion"
    levels: int = 100
    clip: float = 1.0
    prediction: str = "noise"

    def __post_init__(self) -> None:
        check_count(self.levels, "levels", most=MOST)
        diffusion_of(self.prediction, self.levels, self.clip)  # checks

    @property
    def nfe(self) -> int:
        """One for each level."""
        return self.levels

    @property
    def draws(self) -> int:
        """The start, and fresh noise in every step but the last."""
        return self.levels

    @property
    def variants(self) -> list[Sampler]:
        """The chain itself, and DDIM: where the last level is noise alone, from there.

        A network that predicts the noise is sampled with both spacings.
        """
        exact = self.prediction != "noise"
        few = [(n, "trailing") for n in (1, 2, 4, 16)] if exact else product((4, 16), SPACINGS)
        return [self, *(DDIMSampler(n, self.levels, s, self.clip, self.prediction) for n, s in few)]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (levels, B, d) under conditions c (B, k)."""
        diffusion = diffusion_of(self.prediction, self.levels, self.clip)
        return diffusion.ddpm(network, noise[0], c, noise=noise[1:])


@dataclass(frozen=True)
class DDIMSampler(Sampler):
    """Few deterministic steps of a diffusion model."""

    method = "ddim"
    family = "diffusion"
    nfe: int = 16
    levels: int = 100
    spacing: str = "leading"
    clip: float = 1.0
    prediction: str = "noise"

    def __post_init__(self) -> None:
        check_count(self.levels, "levels", most=MOST)
        diffusion = diffusion_of(self.prediction, self.levels, self.clip)
        diffusion.ddim_levels(self.nfe, self.spacing)  # checks

    @property
    def name(self) -> str:
        """For tables: "ddim-16", "ddim-4-trailing"."""
        return super().name + ("" if self.spacing == "leading" else f"-{self.spacing}")

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        diffusion = diffusion_of(self.prediction, self.levels, self.clip)
        return diffusion.ddim(network, noise[0], c, nfe=self.nfe, spacing=self.spacing)


@dataclass(frozen=True)
class JumpSampler(Sampler):
    """Equal jumps with a network of mean velocities.

    Attributes:
        nfe: evaluations of the network for a chunk.
        prediction: of the network, see `MeanFlow`.
    """

    method = "jump"
    family = "mean velocity"
    nfe: int = 16
    prediction: str = "velocity"

    def __post_init__(self) -> None:
        check_count(self.nfe, "nfe", most=MOST)
        check_choice(self.prediction, "prediction", PREDICTIONS)

    @property
    def variants(self) -> list[Sampler]:
        """With 1 to 16 evaluations."""
        return [replace(self, nfe=nfe) for nfe in (1, 2, 4, 16)]

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        mean = cast(MeanVelocity, network)
        return jump(mean, noise[0], c, nfe=self.nfe, prediction=self.prediction)


@dataclass(frozen=True)
class DriftSampler(Sampler):
    """The one answer of a network that was trained by drifting."""

    method = "drift"
    family = "drifting"
    nfe = 1

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        return Drifting().sample(network, noise[0], c)


@dataclass(frozen=True)
class TwoPassSampler(Sampler):
    """The answer of a regression, and its refinement; of the noise only the shape counts."""

    family = "two passes"
    nfe = 2
    name = "two-passes"
    random = False

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) under conditions c (B, k)."""
        return TwoPasses().sample(network, noise[0], c)


@dataclass(frozen=True)
class MeanSampler(Sampler):
    """The one chunk that a regression predicts; of the noise only the shape counts."""

    family = "regression"
    nfe = 1
    name = "mean"
    random = False

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) under conditions c (B, k)."""
        with torch.no_grad():
            return predict(network, noise[0], c)


_KINDS: tuple[Callable[..., Sampler], ...] = (
    *(FlowSampler, DDPMSampler, DDIMSampler, JumpSampler),
    *(DriftSampler, TwoPassSampler, MeanSampler),
)
SAMPLERS = {kind.__name__: kind for kind in _KINDS}  #: by the name in the file of a policy
