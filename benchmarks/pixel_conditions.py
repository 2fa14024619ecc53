"""What should a coupling see where the network sees pixels?

Push-T from pixels, as in `cotlearn bench push-t-pixels`: its network, budget and starts, and but
for one cell one training seed. Strata, with and without residuals, by clusters of the pixels (COT
Policy's recipe), of the true state seen from the T, or of the features of a network that has been
trained with independent pairs; in each, noise is paired with chunks in the directions of the world,
or as they look from the T (`Transformed`); and in that frame naive OT. The best of these, residuals
by the state, again with finer strata and another seed. In the last cells the network predicts the
chunk, and they are rolled out from the starts of `cotlearn bench push-t-pixels --prediction data`,
which the others did not see. Some five to nine CPU minutes a cell.

    python benchmarks/pixel_conditions.py

writes data/results/pixel_conditions.json. An interrupted run goes on.
"""

from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from cells import opened
from short_training import train_and_roll
from torch import Tensor

from cotlearn.assets import find_data
from cotlearn.couplings import Coupling, EmbeddedClusters, KMeansCondition, Transformed
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.pixels import CameraNetwork, turned_with_t
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import EXPLORATION, REPORTED
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import Options
from cotlearn.robots.episodes import Episodes, read, split
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.push_t.frames import BodyFrame

SETTING = {"seed": 0, "held_out": 200, "rollouts": 100}
CHUNK = {"frame": "world", "method": "residual", "clusters": 4096, "prediction": "data"}
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
    {"sees": "state", **CHUNK},
    {"sees": "state", **CHUNK, "seed": 1},
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


def method_of(key: dict[str, Any], options: Options, training: Episodes) -> Method:
    """The method of a cell, whose coupling is given what the cell says."""
    method = find_method(key["method"])
    windows = options.windows(training)
    camera = options.camera.camera(windows)
    clusters = None
    if key["sees"] in ("state", "features"):
        view = StateFromT(camera) if key["sees"] == "state" else features
        clusters = EmbeddedClusters(view, KMeansCondition(options.clusters))
        clusters.fit(windows.dataset(training, label=options.label).c)
        method = replace(method, pictures=None)
    turns = [partial(turned_with_t, camera=camera, sign=sign) for sign in (-1, 1)]

    def coupling(options: Options, pictures: EmbeddedClusters | None) -> Coupling:
        made = find_method(key["method"]).coupling(options, clusters or pictures)
        return Transformed(made, *turns) if key["frame"] == "T" else made

    return replace(method, coupling=coupling)


def features(c: Tensor) -> Tensor:
    """What the shipped encoder, trained with independent pairs, makes of scenes."""
    policy = ChunkPolicy.load(find_data("weights/push_t_pixels_independent.safetensors"))
    assert isinstance(policy.network, CameraNetwork)
    return policy.network.encode(c)


def main() -> None:
    """Fills the table."""
    training, _ = split(read(find_data("push_t_demos.npz")), held_out=SETTING["held_out"])
    common = SETTINGS["push-t-pixels"].options
    table = opened(__doc__ or "", {**SETTING, "options": asdict(common)})

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        options = replace(common, clusters=key.get("clusters", common.clusters))
        options = replace(options, prediction=key.get("prediction", common.prediction))
        return train_and_roll(
            method_of(key, options, training),
            training,
            options,
            seed=key.get("seed", SETTING["seed"]),
            rollouts=SETTING["rollouts"],
            first_seed=REPORTED if "prediction" in key else EXPLORATION,
        )

    table.fill(CELLS, compute)


if __name__ == "__main__":
    main()
