"""Receding-horizon policies: observe a short history, sample an action chunk, execute its start."""

import timeit
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Any, Self, cast

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Generator, Tensor, nn

from cotlearn import validation
from cotlearn.files import reading
from cotlearn.flows.networks import ResidualMLP, rebuilt
from cotlearn.flows.one_step import MeanVelocity
from cotlearn.policies.pixels import CameraNetwork
from cotlearn.policies.samplers import SAMPLERS, Sampler
from cotlearn.policies.windows import Windows
from cotlearn.robots.task import Array
from cotlearn.storage import load_tensors, save_tensors

_FITTED = "fitted."  #: prefix of the coupling's tensors in a file
_NETWORKS: dict[str, Any] = {
    "ResidualMLP": ResidualMLP,
    "CameraNetwork": CameraNetwork,
    "MeanVelocity": lambda **sizes: MeanVelocity(ResidualMLP(**sizes)),
}


@dataclass(eq=False, repr=False)
class ChunkPolicy:
    """A policy that samples and executes action chunks.

    Args:
        network: network(t, x, c) with the sizes of `windows`.
        windows: frame, horizons and scale.
        sampler: samples a chunk from the network.
        execute: steps of a chunk to execute before the next is sampled.
        temperature: factor of the noise, at least 0; 1 samples the learned distribution.
        fitted: state of the coupling's fitted condition, to be saved with the weights; it is not
            needed to act.
        about: further metadata for the file, JSON-compatible, such as how the policy was trained.

    Raises:
        ValueError: the network's sizes or `execute` do not fit the windows.
    """

    network: nn.Module
    windows: Windows
    sampler: Sampler
    _: KW_ONLY
    execute: int = 8
    temperature: float = 1.0
    fitted: dict[str, Tensor] = field(default_factory=dict)
    about: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("dim", "condition_dim"):
            got, expected = getattr(self.network, name, None), getattr(self.windows, name)
            if got != expected:
                raise ValueError(f"network has {name} {got}, but these windows need {expected}")
        check_execute(self.execute, self.windows.predict)
        validation.check_number(self.temperature, "temperature")
        wanted = "a sampler such as FlowSampler()"
        validation.check_has(self.sampler, "sampler", wanted, "draws", "nfe")
        self.network.eval()

    def with_sampler(self, sampler: Sampler) -> Self:
        """The same policy with another sampler.

        Raises:
            ValueError: the network was trained for another kind of sampler.
        """
        if self.sampler.training and sampler.training not in ("", self.sampler.training):
            raise ValueError(
                f"sampler must be for the training {self.sampler.training!r}, "
                f"got {sampler} for {sampler.training!r}"
            )
        return replace(self, sampler=sampler)

    def noise(self, n: int, generator: Generator | None = None) -> Tensor:
        """Draw the noise (draws, n, d) that `act` needs for n rows.

        The first draw is the same for every sampler, so that policies can be compared on the same
        noise.
        """
        validation.check_generator(generator)
        rows = validation.check_count(n, "n")
        shape = self.sampler.draws, rows, self.windows.dim
        weights = next(self.network.parameters()).dtype
        return torch.randn(shape, dtype=weights, generator=generator)

    @torch.no_grad()
    def draw(self, noise: Tensor, c: Tensor) -> Tensor:
        """Sample scaled chunks (B, d) from noise (draws, B, d) under conditions c (B, k).

        A `CameraNetwork` encodes its images once for all evaluations.

        Raises:
            TypeError: noise is not a floating-point tensor.
            ValueError: the shape of noise does not fit c or the policy.
        """
        validation.check_shape(noise, "noise", (self.sampler.draws, len(c), self.windows.dim))
        validation.check_matrix(noise.flatten(1), "noise")
        noise = self.temperature * noise
        if isinstance(self.network, CameraNetwork):
            return self.sampler(self.network.head, noise, self.network.encode(c))
        return self.sampler(self.network, noise, c)

    def chunk(
        self, history: ArrayLike, *, noise: Tensor | None = None, generator: Generator | None = None
    ) -> Array:
        """Sample chunks (B, predict, A) of actions, clipped to the limits of the task.

        Args:
            history: (B, observe, columns), the last states, the current one last.
            noise: (draws, B, d), as `noise` returns it; fresh if None.
            generator: of fresh noise.

        Raises:
            TypeError: the history does not hold real numbers.
            ValueError: the history or the noise does not fit the policy.
            RuntimeError: the network's output is not finite.
        """
        shape = (None, self.windows.observe, len(self.windows.task.state))
        history = validation.check_array(history, "history", shape)
        if noise is None:
            noise = self.noise(len(history), generator)
        x = self.draw(noise, self.windows.condition(history))
        actions = self.windows.actions(x, history)
        if not np.isfinite(actions).all():
            raise RuntimeError("the policy's actions are not finite: its training diverged")
        return actions.clip(*self.windows.task.action_limits)

    def act(
        self, history: ArrayLike, *, noise: Tensor | None = None, generator: Generator | None = None
    ) -> Array:
        """The next actions (B, execute, A) to execute; arguments as for `chunk`."""
        return self.chunk(history, noise=noise, generator=generator)[:, : self.execute]

    def latency(self, *, repetitions: int = 30) -> float:
        """Median seconds to sample one chunk, from state to actions."""
        validation.check_count(repetitions, "repetitions")
        generator = Generator().manual_seed(0)
        state = self.windows.task.vector_sim([0]).states
        history = np.repeat(state[:, None], self.windows.observe, axis=1)
        chunk = timeit.Timer(lambda: self.act(history, generator=generator))
        return float(np.median(chunk.repeat(repetitions + 2, number=1)[2:]))  # two warm up

    def save(self, path: str | Path, *, half: bool = False) -> None:
        """Write network, windows, sampler and metadata to a safetensors file.

        Args:
            path: the file.
            half: store weights in 16 bits, which halves the file.

        Raises:
            TypeError: the network is of a kind that `load` does not know.
            ValueError: half, and a weight is too large for 16 bits.
        """
        kind = type(self.network).__name__
        if kind not in _NETWORKS:
            raise TypeError(f"network must be one of {', '.join(_NETWORKS)} to save it, got {kind}")
        tensors = {f"{_FITTED}{name}": value for name, value in self.fitted.items()}
        tensors |= self.network.state_dict()
        if half:
            tensors = {n: v.half() if v.is_floating_point() else v for n, v in tensors.items()}
            if lost := [n for n, v in tensors.items() if v.isinf().any()]:
                raise ValueError(f"half must be False: {lost[0]} exceeds 65504, its largest number")
        record = {
            "policy": {
                "network": {"kind": kind, **cast(Any, self.network).sizes},
                "windows": self.windows.metadata(),
                "sampler": {"kind": type(self.sampler).__name__, **vars(self.sampler)},
                "execute": self.execute,
                "temperature": self.temperature,
            },
            "about": self.about,
        }
        save_tensors(path, tensors, record)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a policy that `save` wrote, with weights in float32.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: the file is damaged or contains no policy.
        """
        tensors, record = load_tensors(path)
        with reading(path, "holds no policy that fits"):
            if "policy" not in record:
                raise ValueError("it holds something else that cotlearn saved")
            stored = record["policy"]
            sizes, sampler = dict(stored["network"]), dict(stored["sampler"])
            tensors = {name: value.float() for name, value in tensors.items()}
            fitted = {n: tensors.pop(n) for n in list(tensors) if n.startswith(_FITTED)}
            network = rebuilt(_NETWORKS[sizes.pop("kind")], sizes, tensors)
            return cls(
                network.requires_grad_(False),
                Windows.from_metadata(stored["windows"]),
                SAMPLERS[sampler.pop("kind")](**sampler),
                execute=stored["execute"],
                temperature=stored["temperature"],
                fitted={name.removeprefix(_FITTED): value for name, value in fitted.items()},
                about=dict(record["about"]),
            )


def check_execute(execute: int, predict: int) -> None:
    """Raise ValueError unless `execute` is from 1 to `predict`."""
    validation.check_count(execute, "execute", most=predict, of="the {} predicted steps")
