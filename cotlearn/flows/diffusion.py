"""DDPM and DDIM on the same networks: the baseline that flow matching policies are measured by."""

import math
import warnings
from dataclasses import KW_ONLY, dataclass
from functools import cached_property

import torch
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings.base import Pairs
from cotlearn.flows.matching import Velocity, check_same_type, evaluate, squared_error

SPACINGS = ("leading", "trailing")
PREDICTIONS = ("velocity", "data", "noise")
LARGEST_BETA = 0.999


@dataclass(frozen=True)
class Diffusion:
    """A diffusion model with N noise levels k = 0 .. N-1.

    x_k = sqrt(a_k) x1 + sqrt(1 - a_k) x0 with noise x0, and a_k the squared cosine of Nichol &
    Dhariwal (2102.09672, eq. 17), as in Diffusion Policy (2303.04137). The network is called as
    network(k / N, x_k, c), so that any velocity network serves.

    Args:
        levels: N, at least 2 (Diffusion Policy: 100).
        clip: the predicted x1 is clipped to [-clip, clip] while sampling; None: no clipping.
        prediction: what the network predicts: the "noise" x0 (Ho 2006.11239), the "data" x1, or
            the "velocity" sqrt(a_k) x0 - sqrt(1 - a_k) x1 (Salimans & Ho 2202.00512).
        zero_terminal_snr: rescale a_k so that the last level is noise alone (Lin 2305.08891,
            algorithm 1), as sampling from noise assumes; not for a network that predicts the
            noise, which says nothing about x1 there.
    """

    levels: int = 100
    _: KW_ONLY
    clip: float | None = 1.0
    prediction: str = "noise"
    zero_terminal_snr: bool = False

    def __post_init__(self) -> None:
        validation.check_count(self.levels, "levels", minimum=2)
        if self.clip is not None:
            validation.check_positive(self.clip, "clip")
        validation.check_choice(self.prediction, "prediction", PREDICTIONS)
        if self.zero_terminal_snr and self.prediction == "noise":
            raise ValueError("prediction must be data or velocity with zero_terminal_snr")

    @cached_property
    def alphas_cumprod(self) -> Tensor:
        """a_k, (N,), the share of the data's variance at level k, falling."""
        a = _squared_cosine(self.levels)
        return _zero_terminal_snr(a) if self.zero_terminal_snr else a

    def loss(self, network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The squared error at one uniform level per row, (B,) (2006.11239, eq. 14).

        It is a loss for `fit`. The noise is the x0 of the pairs, from any coupling. Warns
        (UserWarning) if the data lie beyond `clip`, where no sample will.
        """
        if self.clip is not None and (far := float(pairs.x1.abs().max())) > 1.05 * self.clip:
            warnings.warn(
                f"x1 reaches {far:.3g}, and samples are clipped to {self.clip:g}: scale the data, "
                "or choose clip=None",
                stacklevel=2,
            )
        check_same_type(pairs.x1, pairs.x0)
        k = torch.randint(self.levels, (len(pairs),), generator=generator).to(pairs.x0.device)
        a = self.alphas_cumprod.to(pairs.x0.device)[k][:, None].double()
        signal, noise = a.sqrt().to(pairs.x0), (1 - a).sqrt().to(pairs.x0)  # each to its own digits
        x = signal * pairs.x1 + noise * pairs.x0
        velocity = signal * pairs.x0 - noise * pairs.x1
        target = {"noise": pairs.x0, "data": pairs.x1, "velocity": velocity}[self.prediction]
        return squared_error(network((k / self.levels).to(x), x, pairs.c), target)

    @torch.no_grad()
    def ddpm(
        self, network: Velocity, x: Tensor, c: Tensor | None = None, *, noise: Tensor
    ) -> Tensor:
        """Samples by all N steps of the ancestral chain (Ho 2006.11239, algorithm 2).

        Args:
            network: trained with `loss`.
            x: (B, d) noise to start from.
            c: (B, k), or None.
            noise: (N - 1, B, d), standard normal, added in each step but the last.
        """
        validation.check_sampled(network, x, c, "x")
        validation.check_shape(noise, "noise", (self.levels - 1, *x.shape))
        validation.check_matrix(noise.flatten(1), "noise")
        noise = noise.to(x)
        a = self.alphas_cumprod.double().tolist()
        for number, k in enumerate(reversed(range(self.levels))):
            before = a[k - 1] if k else 1.0
            step = a[k] / before  # 1 - beta_k
            x1, _ = self._split(network, k, x, c)
            of_x1 = math.sqrt(before) * (1 - step) / (1 - a[k])
            of_x = math.sqrt(step) * (1 - before) / (1 - a[k])
            x = of_x1 * x1 + of_x * x
            if k:
                x = x + math.sqrt((1 - before) / (1 - a[k]) * (1 - step)) * noise[number]
        return x

    @torch.no_grad()
    def ddim(
        self,
        network: Velocity,
        x: Tensor,
        c: Tensor | None = None,
        *,
        nfe: int,
        spacing: str = "leading",
    ) -> Tensor:
        """Samples by nfe deterministic steps (Song 2010.02502, eq. 12 with sigma = 0).

        Args:
            network: trained with `loss`.
            x: (B, d) noise to start from.
            c: (B, k), or None.
            nfe: evaluations of the network, at most N.
            spacing: "leading": levels 0, s, 2s, ... with s = floor(N / nfe), the default of
                Diffusion Policy's; with nfe = 1 it is level 0 alone, where x counts as data, so
                that the noise comes back. "trailing": N - 1, N - 1 - N / nfe, ..., which starts
                where there is only noise (2305.08891, with zero_terminal_snr).
        """
        validation.check_sampled(network, x, c, "x")
        levels = self.ddim_levels(nfe, spacing)
        for k, after in zip(levels, [*levels[1:], None], strict=True):
            x1, noise = self._split(network, k, x, c)
            a = 1.0 if after is None else float(self.alphas_cumprod[after])
            x = math.sqrt(a) * x1 + math.sqrt(1 - a) * noise
        return x

    def ddim_levels(self, nfe: int, spacing: str = "leading") -> list[int]:
        """The levels at which `ddim` evaluates the network, falling."""
        validation.check_count(nfe, "nfe", most=self.levels, of="the {} levels")
        if validation.check_choice(spacing, "spacing", SPACINGS) == "leading":
            return [self.levels // nfe * i for i in reversed(range(nfe))]
        return [round(self.levels * (nfe - i) / nfe) - 1 for i in range(nfe)]

    def _split(
        self, network: Velocity, k: int, x: Tensor, c: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """The x1, clipped, and the noise that the network predicts from x at level k."""
        t = torch.tensor(k / self.levels, dtype=x.dtype, device=x.device)
        predicted = evaluate(network, t, x, c, name="network")
        a = float(self.alphas_cumprod[k])
        signal, noise = math.sqrt(a), math.sqrt(1 - a)
        if self.prediction == "noise":
            x1, x0 = (x - noise * predicted) / signal, predicted
        elif self.prediction == "data":
            x1, x0 = predicted, (x - signal * predicted) / noise
        else:
            x1, x0 = signal * x - noise * predicted, noise * x + signal * predicted
        return (x1 if self.clip is None else x1.clamp(-self.clip, self.clip)), x0


def _squared_cosine(levels: int) -> Tensor:
    """a_k = prod (1 - beta_j) with beta_j = min(0.999, 1 - f(j + 1) / f(j)), float64."""
    time = torch.arange(levels + 1, dtype=torch.float64) / levels
    f = ((time + 0.008) / 1.008 * math.pi / 2).cos().square()
    beta = (1 - f[1:] / f[:-1]).clamp(max=LARGEST_BETA)
    return (1 - beta).cumprod(dim=0)


def _zero_terminal_snr(a: Tensor) -> Tensor:
    """Shifts and scales sqrt(a_k): the first stays as it is, the last becomes 0."""
    root = a.sqrt()
    return ((root - root[-1]) * root[0] / (root[0] - root[-1])).square()


def regression_loss(network: Velocity, pairs: Pairs, generator: torch.Generator) -> Tensor:
    """|network(0, 0, c) - x1|^2, (B,): mean-squared-error behaviour cloning on the same network."""
    return squared_error(predict(network, pairs.x1, pairs.c), pairs.x1)


def predict(network: Velocity, x: Tensor, c: Tensor | None) -> Tensor:
    """What a network trained with `regression_loss` predicts; only the shape of x is used."""
    return network(torch.zeros((), dtype=x.dtype, device=x.device), torch.zeros_like(x), c)
