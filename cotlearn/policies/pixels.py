"""What it takes to train policies on pictures: options like the others'."""

from __future__ import annotations

from dataclasses import dataclass

from torch import nn

from cotlearn.couplings.conditions import EmbeddedClusters, PCAKMeansCondition
from cotlearn.datasets import Dataset
from cotlearn.flows.matching import Loss
from cotlearn.policies.camera import CameraLoss, CameraNetwork
from cotlearn.policies.training import Options
from cotlearn.policies.windows import Windows
from cotlearn.robots.push_t.camera import Camera
from cotlearn.validation import check_count


@dataclass(frozen=True)
class CameraOptions(Options):
    """`Options` of a policy that sees Push-T through a camera.

    Attributes:
        size: width and height of a picture in pixels.
        features: of a picture, beside the pose.
        pose: weight of the pose's squared error in the loss, see `CameraLoss`.
        shift: pixels by which pictures are shifted at random in training.
        components: of the PCA that the coupling sees pixels by.
        condition_clusters: of the k-means after it, for COT; stratified OT has `clusters`.
    """

    network: str = "camera"
    frame: str | None = "agent"
    size: int = 40
    features: int = 32
    pose: float = 1000.0
    shift: int = 0
    components: int = 50
    condition_clusters: int = 64

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.network, self.frame) != ("camera", "agent"):
            raise ValueError(
                "a policy with a camera has network 'camera' and frame 'agent', got "
                f"{self.network!r} and {self.frame!r}"
            )
        for name in ("size", "components", "condition_clusters"):
            check_count(getattr(self, name), name)

    def loss_of(self, method: str) -> Loss:
        """What a method minimises, with the loss of the pose."""
        return CameraLoss(super().loss_of(method), self.pose, self.shift)

    def camera(self, windows: Windows) -> Camera:
        """The camera for scenes on the scale of these windows."""
        return Camera.over(windows.observation_range, size=self.size, observe=self.observe)

    def make_network(self, windows: Windows, *, seed: int) -> nn.Module:
        """A network that sees."""
        return CameraNetwork(
            self.camera(windows),
            windows.dim,
            features=self.features,
            width=self.width,
            blocks=self.blocks,
            seed=seed,
        )

    def asks_the_frontier(self, method: str) -> bool:
        """Not for COT's weight: without one it is COT Policy's rule for every batch."""
        return method != "conditional_ot"

    def condition_of(
        self, method: str, data: Dataset, windows: Windows | None = None
    ) -> EmbeddedClusters | None:
        """Clusters of pictures and proprioception, COT Policy's condition, fitted to the data."""
        clusters = {
            "conditional_ot": self.condition_clusters,
            "stratified": self.clusters,
            "residual": self.clusters,
        }.get(method)
        if clusters is None:
            return None
        assert data.c is not None
        assert windows is not None
        camera = self.camera(windows)
        condition = PCAKMeansCondition(
            pixels=camera.pixels, components=self.components, clusters=clusters
        )
        return EmbeddedClusters(camera, condition).fit(data.c)
