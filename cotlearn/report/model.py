"""The few-step model that a report trains; it takes and returns values in the data's units."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import torch
from torch import Generator, Tensor, nn

from cotlearn.couplings.units import OwnUnits, TamedStandardiser
from cotlearn.datasets import Standardiser
from cotlearn.files import reading
from cotlearn.flows import VelocityMLP, integrate
from cotlearn.flows.networks import rebuilt
from cotlearn.storage import load_tensors, save_tensors
from cotlearn.validation import check_condition, check_matrix

UNITS = ("centre", "spread", "ranked", "knots")  #: what `OwnUnits` holds


@dataclass(frozen=True)
class FewStepModel:
    """Draws x1 given c, in the units of the data.

    Attributes:
        network: the velocity, in standard units.
        x: between the two, for x1.
        c: the same for conditions, of which far values are drawn near.
        about: coupling, data, versions; JSON-compatible.
    """

    network: nn.Module
    x: Standardiser
    c: TamedStandardiser
    about: dict[str, Any]

    def sample(self, c: Tensor, *, nfe: int = 1, generator: Generator | None = None) -> Tensor:
        """Sample one x1 (n, d) for each row of c (n, k) with `nfe` Euler steps."""
        c = check_matrix(check_condition(c), "c", columns=len(self.c.scaler.mean))
        x0 = torch.randn(len(c), len(self.x.mean), generator=generator)
        return self.x.inverse(integrate(self.network, x0, self.c(c), nfe=nfe).x1)

    def save(self, path: str | Path) -> None:
        """Write a safetensors file, atomically."""
        tensors = {f"network.{k}": v for k, v in self.network.state_dict().items()}
        for name, scale in (("x", self.x), ("c", self.c.scaler)):
            tensors[f"scale.{name}"] = torch.stack([scale.mean, scale.std])
        for name in UNITS:
            tensors[f"units.{name}"] = getattr(self.c.units, name)
        save_tensors(path, tensors, self.about)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ValueError: it is damaged, or no few-step model.
        """
        tensors, about = load_tensors(path)
        with reading(path, "is no few-step model of a report"):
            x, c = (Standardiser(*tensors.pop(f"scale.{name}")) for name in "xc")
            units = OwnUnits(*(tensors.pop(f"units.{name}") for name in UNITS))
            sizes = {"dim": len(x.mean), "condition_dim": len(c.mean), **about["network"]}
            weights = {k.removeprefix("network."): v for k, v in tensors.items()}
            network = rebuilt(VelocityMLP, sizes, weights)
        return cls(network.eval(), x, TamedStandardiser(units, c), about)
