"""The few-step model that a report leaves behind: units of your data in, units of your data out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.datasets import Dataset
from cotlearn.flows import VelocityMLP, integrate
from cotlearn.storage import load_tensors, save_tensors
from cotlearn.validation import check_condition, check_matrix


@dataclass(frozen=True)
class Scale:
    """Columns of x1 and c to mean 0 and standard deviation 1, and back; as the training rows say.

    Attributes:
        x: (2, d), mean and standard deviation of x1; where it does not vary, 0.
        c: (2, k), of c.
    """

    x: Tensor
    c: Tensor

    @classmethod
    def fit(cls, data: Dataset) -> Scale:
        """The scale of these rows."""
        assert data.c is not None
        return cls(_moments(data.x1), _moments(data.c))

    def into(self, data: Dataset) -> Dataset:
        """Rows in standard units."""
        assert data.c is not None
        return Dataset(_scaled(data.x1, self.x), self.condition(data.c), data.name)

    def condition(self, c: Tensor) -> Tensor:
        """Conditions in standard units."""
        return _scaled(c, self.c)

    def out(self, x: Tensor) -> Tensor:
        """Samples in the units of the data."""
        return self.x[0] + self.x[1] * x


@dataclass(frozen=True)
class FewStepModel:
    """Draws x1 given c, in the units of the data.

    Attributes:
        network: the velocity, in standard units.
        scale: between the two.
        about: coupling, data, versions; JSON-compatible.
    """

    network: nn.Module
    scale: Scale
    about: dict[str, Any]

    def sample(
        self, c: Tensor, *, nfe: int = 1, generator: torch.Generator | None = None
    ) -> Tensor:
        """One x1 (n, d) for each row of c (n, k), by `nfe` Euler steps."""
        c = check_matrix(check_condition(c), "c", columns=self.scale.c.shape[1])
        x0 = torch.randn(len(c), self.scale.x.shape[1], generator=generator)
        return self.scale.out(integrate(self.network, x0, self.scale.condition(c), nfe=nfe).x1)

    def save(self, path: str | Path) -> None:
        """Write a safetensors file, atomically."""
        tensors = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        tensors |= {"scale.x": self.scale.x, "scale.c": self.scale.c}
        save_tensors(path, tensors, self.about)

    @classmethod
    def load(cls, path: str | Path) -> FewStepModel:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, or no few-step model.
        """
        tensors, about = load_tensors(path)
        try:
            scale = Scale(tensors["scale.x"], tensors["scale.c"])
            network = VelocityMLP(scale.x.shape[1], scale.c.shape[1], **about["network"])
            weights = {
                name.removeprefix("network."): value
                for name, value in tensors.items()
                if name.startswith("network.")
            }
            network.load_state_dict(weights)
        except (KeyError, TypeError, RuntimeError) as error:
            raise ValueError(f"{path} is no few-step model of a report: {error}") from error
        return cls(network.eval(), scale, about)


def _moments(values: Tensor) -> Tensor:
    varies = (values != values[0]).any(dim=0)
    deviation = torch.where(varies, values.std(dim=0, unbiased=False), 0)
    return torch.stack([values.mean(dim=0), deviation])


def _scaled(values: Tensor, moments: Tensor) -> Tensor:
    mean, deviation = moments
    return torch.where(deviation > 0, (values - mean) / deviation.clamp(min=1e-30), 0.0)
