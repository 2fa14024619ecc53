"""Push-T from pixels, where the coupling sees the state and the network the pixels.

The row of `cotlearn bench push-t-pixels residual`, but with 4,096 strata of the true state as it is
seen from the T. The method's name in the tables is "state_residual". Some six CPU minutes a seed.

    python benchmarks/state_strata.py

adds rows to data/results/episodes.csv.gz and study.csv. An interrupted run goes on.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from cells import RESULTS
from torch import Tensor

from cotlearn.couplings import Coupling, EmbeddedClusters, KMeansCondition
from cotlearn.course.assets import find_data
from cotlearn.policies.bench import bench
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.options import Options
from cotlearn.policies.settings import SETTINGS
from cotlearn.robots.episodes import Episodes, read, split
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.push_t.frames import BodyFrame

STRATA = 4096


class StateFromT:
    """Scenes as the true T sees them: what the policies that observe the state are given."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera

    def __call__(self, c: Tensor) -> Tensor:
        """(B, observe * 6) from scenes c (B, k)."""
        scenes = self.camera.scenes(c).double().numpy()
        angle = np.arctan2(scenes[..., 5], scenes[..., 4])
        seen = BodyFrame().observe(np.concatenate([scenes[..., :4], angle[..., None]], axis=-1))
        return torch.from_numpy(seen).flatten(1).to(c)


def state_residual(options: Options, training: Episodes) -> Method:
    """Residual pairs whose strata are clusters of states, fitted to the training windows."""
    assert options.camera is not None
    windows = options.windows(training)
    view = StateFromT(options.camera.camera(windows))
    clusters = EmbeddedClusters(view, KMeansCondition(STRATA))
    clusters.fit(windows.dataset(training, label=options.label).c)
    residual = find_method("residual")

    def coupling(options: Options, pictures: EmbeddedClusters | None) -> Coupling:
        return residual.coupling(options, clusters)

    return replace(residual, name="state_residual", coupling=coupling, pictures=None)


def main() -> None:
    """Adds the rows of three seeds."""
    torch.set_num_threads(1)
    setting = SETTINGS["push-t-pixels"]
    setting = replace(setting, options=replace(setting.options, clusters=STRATA))
    demonstrations = read(find_data("push_t_demos.npz"))
    training, _ = split(demonstrations, held_out=setting.held_out)
    bench(
        setting,
        demonstrations,
        methods=[state_residual(setting.options, training)],
        seeds=[0, 1, 2],
        weights=Path("build/state_strata"),
        episodes_table=RESULTS / "episodes.csv.gz",
        study_table=RESULTS / "study.csv",
        course=True,
    )


if __name__ == "__main__":
    main()
