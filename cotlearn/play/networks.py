"""The small networks of the panel *samples*: one for each data set and coupling."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from torch import Tensor

from cotlearn import mixtures
from cotlearn.couplings import ConditionalOT, Coupling, Independent
from cotlearn.course.assets import find_data
from cotlearn.flows.networks import VelocityMLP
from cotlearn.flows.training import fit
from cotlearn.storage import load_tensors

FILE = "weights/playground.safetensors"
DATA: dict[str, Callable[[], Any]] = {
    "petals": mixtures.petals,
    "moving_modes": mixtures.moving_modes,
    "rotating_pair": mixtures.rotating_pair,
}
WEIGHTS = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, math.inf)  #: of the condition; 0 is naive OT
WIDTH, DEPTH = 48, 3
STEPS, BATCH = 1500, 256


def couplings(data: Any) -> dict[str, Coupling]:
    """Name -> coupling, for one of `DATA`.

    Where every row has a condition of its own, w = infinity pairs no row with another: it is the
    independent coupling, which is listed once.
    """
    labelled = len(data.conditions()) == data.condition_dim
    weights = WEIGHTS if labelled else WEIGHTS[:-1]
    conditional = {f"{weight:g}": ConditionalOT(weight) for weight in weights}
    return {"independent": Independent(), **conditional}


def train(name: str, coupling: Coupling) -> VelocityMLP:
    """Train the network of a data set and a coupling; 6 to 18 s on one core."""
    data = DATA[name]()
    start = empty(data)
    network = fit(start, data, coupling, steps=STEPS, batch_size=BATCH, progress=False).network
    assert isinstance(network, VelocityMLP)
    return network


def empty(data: Any) -> VelocityMLP:
    """A network of this size, before training."""
    return VelocityMLP(data.dim, data.condition_dim, width=WIDTH, depth=DEPTH, seed=0)


def shipped() -> dict[str, dict[str, list[Tensor]]]:
    """The trained weights: data set -> coupling -> matrices and biases in turn, in 32 bits.

    Raises:
        ValueError: the file is damaged.
    """
    tensors, _ = load_tensors(find_data(FILE))
    found: dict[str, dict[str, list[Tensor]]] = {}
    for name, make in DATA.items():
        data = make()
        keys = empty(data).state_dict()
        found[name] = {
            coupling: [tensors[f"{name} {coupling} {key}"].float() for key in keys]
            for coupling in couplings(data)
        }
    return found
