"""The state of a training, to disk and back: a resumed training continues bit for bit."""

import copy
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.couplings.base import Coupling
from cotlearn.flows.fingerprint import COMPILED, plain_state
from cotlearn.storage import load_tensors, save_tensors


class State:
    """The state of a training; `plan` holds the options that must not change when it resumes.

    `weights` and `averages` are the parameters of the two networks: to collect them at every step
    takes as long as the step of a small network's optimizer.
    """

    def __init__(self, network: nn.Module, coupling: Coupling, plan: dict[str, Any]) -> None:
        self.network = copy.deepcopy(network).train()
        if not any(p.requires_grad for p in network.parameters()):  # a network that `fit` returned
            self.network.requires_grad_(True)
        self.averaged = copy.deepcopy(network).requires_grad_(False).eval()
        self.weights: list[Tensor] = list(self.network.parameters())
        self.averages: list[Tensor] = list(self.averaged.parameters())
        self.optimizer = torch.optim.Adam(self.weights, lr=plan["learning_rate"], fused=True)
        self.coupling, self.plan = coupling, plan
        self.step, self.seconds = 0, 0.0
        self.unlogged: list[Tensor] = []
        self.log: list[tuple[float, ...]] = []

    def finite_losses(self) -> list[float]:
        """The losses since the last entry of the log.

        Raises:
            RuntimeError: one of them is not finite.
        """
        losses = [float(value) for value in self.unlogged]
        for value in losses:
            if not math.isfinite(value):
                became = f"the loss became {value} by step {self.step}"
                raise RuntimeError(f"{became}: lower learning_rate, or check the data")
        return losses


def save(path: str | Path, state: State) -> None:
    """Write the state of a training atomically.

    Raises:
        RuntimeError: a loss is not finite; the file stays as it was.
    """
    parts = {
        "network": plain_state(state.network),
        "averaged": plain_state(state.averaged),
        "coupling": state.coupling.state_dict(),
    }
    for i, moments in state.optimizer.state_dict()["state"].items():
        parts[f"optimizer.{i}"] = moments
    tensors = {f"{part}.{k}": v for part, values in parts.items() for k, v in values.items()}
    tensors["log"] = torch.tensor(state.log, dtype=torch.float64).reshape(-1, 3)
    tensors["unlogged"] = torch.tensor(state.finite_losses(), dtype=torch.float64)
    about = {"plan": state.plan, "step": state.step, "seconds": state.seconds}
    save_tensors(path, tensors, about)


def load(path: str | Path, state: State) -> None:
    """Bring a fresh state to where `save` wrote it.

    Raises:
        ValueError: the file is damaged, or is of another training.
    """
    tensors, about = load_tensors(path)
    then = about.get("plan", {})
    for name, value in state.plan.items():
        if then.get(name) != value:
            raise ValueError(
                f"checkpoint {path} is of another training: {name} was {then.get(name)!r}, now it "
                f"is {value!r}; give another path, or delete the file to start again"
            )

    def part(prefix: str) -> dict[str, Tensor]:
        return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}

    for network, stored in ((state.network, "network."), (state.averaged, "averaged.")):
        names = {name.replace(COMPILED, ""): name for name in network.state_dict()}
        network.load_state_dict({names[plain]: value for plain, value in part(stored).items()})
    numbers = {int(name.split(".")[0]) for name in part("optimizer.")}
    moments = {i: part(f"optimizer.{i}.") for i in sorted(numbers)}
    groups = state.optimizer.state_dict()["param_groups"]
    state.optimizer.load_state_dict({"state": moments, "param_groups": groups})
    state.coupling.load_state_dict(part("coupling."))
    state.log = [tuple(row) for row in tensors["log"].tolist()]
    state.unlogged = list(tensors["unlogged"])
    state.step, state.seconds = about["step"], about["seconds"]
