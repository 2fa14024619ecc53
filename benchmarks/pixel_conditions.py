"""What should a coupling see where the network sees pixels?

Push-T from pixels, as in `cotlearn bench push-t-pixels`: its network, budget and starts, and but
for one cell one training seed. Strata, with and without residuals, by clusters of the pixels (COT
Policy's recipe), of the true state seen from the T, or of the features of a network that has been
trained with independent pairs; in each, noise is paired with chunks in the directions of the world,
or as they look from the T (`Transformed`); and in that frame naive OT. The best of these, residuals
by the state, again with finer strata and another seed. Some five CPU minutes a cell.

    python benchmarks/pixel_conditions.py

writes data/results/pixel_conditions.json. An interrupted run goes on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from cells import RESULTS, Table
from short_training import train_and_roll
from torch import Tensor

from cotlearn.assets import find_data
from cotlearn.couplings import Coupling, EmbeddedClusters, KMeansCondition, Transformed
from cotlearn.datasets import Dataset
from cotlearn.policies.camera import CameraNetwork, SeenFromT
from cotlearn.policies.pixels import CameraOptions
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import read, split
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.push_t.frames import BodyFrame

SETTING = {"seed": 0, "held_out": 200, "rollouts": 100}
CELLS = [
    *({"sees": "state", "frame": "T", "method": method} for method in ("stratified", "residual")),
    {"sees": "pixels", "frame": "T", "method": "stratified"},
    {"sees": "state", "frame": "world", "method": "stratified"},
    {"sees": "nothing", "frame": "T", "method": "minibatch_ot"},
    {"sees": "features", "frame": "world", "method": "stratified"},
    {"sees": "state", "frame": "T", "method": "residual", "clusters": 4096},
    {"sees": "state", "frame": "world", "method": "residual", "clusters": 4096},
    {"sees": "pixels", "frame": "world", "method": "residual", "clusters": 4096},
    {"sees": "state", "frame": "T", "method": "residual", "clusters": 4096, "seed": 1},
    {"sees": "state", "frame": "T", "method": "residual", "clusters": 16384},
]


class StateFromT:
    """Scenes as the true T sees them: what the state policies of notebook 08 are given."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def __call__(self, c: Tensor) -> Tensor:
        """(B, observe * 6) from scenes c (B, k)."""
        scenes = self.camera.scenes(c).double().numpy()
        angle = np.arctan2(scenes[..., 5], scenes[..., 4])
        seen = BodyFrame().observe(np.concatenate([scenes[..., :4], angle[..., None]], axis=-1))
        return torch.from_numpy(seen).flatten(1).to(c)


@dataclass(frozen=True)
class Sight(CameraOptions):
    """Options with what the coupling sees, and from where.

    Attributes:
        sees: "pixels", "features", "state" or "nothing".
        seen_from: "world" or "T".
    """

    sees: str = "pixels"
    seen_from: str = "world"

    def condition_of(
        self, method: str, data: Dataset, windows: Windows | None = None
    ) -> EmbeddedClusters | None:
        """Clusters of what is seen."""
        assert windows is not None
        if self.sees in ("pixels", "nothing"):
            return super().condition_of(method, data, windows)
        assert data.c is not None
        assert self.clusters is not None
        view = StateFromT(self.camera(windows)) if self.sees == "state" else features
        return EmbeddedClusters(view, KMeansCondition(self.clusters)).fit(data.c)

    def coupling_of(
        self, method: str, seen: EmbeddedClusters | None = None, windows: Windows | None = None
    ) -> Coupling:
        """In the frame of the T, if asked."""
        coupling = super().coupling_of(method, seen, windows)
        if self.seen_from == "world":
            return coupling
        assert windows is not None
        turn = SeenFromT(self.camera(windows))
        return Transformed(coupling, turn.into, turn.out)


def features(c: Tensor) -> Tensor:
    """What the shipped encoder, trained with independent pairs, makes of scenes."""
    policy = ChunkPolicy.load(find_data("weights/push_t_pixels_independent.safetensors"))
    assert isinstance(policy.network, CameraNetwork)
    return policy.network.encode(c)


def main() -> None:
    """Fills the table."""
    torch.set_num_threads(1)
    training, _ = split(read(find_data("push_t_demos.npz")), held_out=SETTING["held_out"])
    common = vars(SETTINGS["push-t-pixels"].options)
    table = Table(
        RESULTS / "pixel_conditions.json",
        question=(__doc__ or "").splitlines()[0],
        protocol={**SETTING, "options": common},
    )

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        finer = {name: key[name] for name in ("clusters",) if name in key}
        options = Sight(**{**common, **finer}, sees=key["sees"], seen_from=key["frame"])
        seed = key.get("seed", SETTING["seed"])
        return train_and_roll(
            key["method"], training, options, seed=seed, rollouts=SETTING["rollouts"]
        )

    table.fill(CELLS, compute)


if __name__ == "__main__":
    main()
