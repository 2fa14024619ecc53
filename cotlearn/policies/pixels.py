"""What it takes to train policies on pictures: a camera, its network, loss and condition."""

from dataclasses import dataclass
from typing import Any

from torch import Tensor

from cotlearn.couplings.conditions import EmbeddedClusters, PCAKMeansCondition
from cotlearn.flows.matching import Loss
from cotlearn.policies.camera import CameraLoss, CameraNetwork
from cotlearn.policies.windows import Windows
from cotlearn.renamed import renamed
from cotlearn.robots.push_t.camera import Camera
from cotlearn.validation import check_count


@dataclass(frozen=True)
class Pixels:
    """A policy of Push-T that sees through a camera: `Options(camera=Pixels())`.

    Attributes:
        size: width and height of a picture in pixels.
        features: of a picture, beside the pose.
        pose: weight of the pose's squared error in the loss, see `CameraLoss`.
        shift: pixels by which pictures are shifted at random in training.
        components: of the PCA of pixels that the coupling is given.
        condition_clusters: of the k-means after it, for COT; stratified OT has `Options.clusters`.
    """

    size: int = 40
    features: int = 32
    pose: float = 1000.0
    shift: int = 0
    components: int = 50
    condition_clusters: int = 64

    def __post_init__(self) -> None:
        for name in ("size", "components", "condition_clusters"):
            check_count(getattr(self, name), name)

    def loss(self, loss: Loss) -> CameraLoss:
        """A loss, with that of the pose."""
        return CameraLoss(loss, self.pose, self.shift)

    def camera(self, windows: Windows) -> Camera:
        """The camera for scenes on the scale of these windows."""
        return Camera(self.size, windows.observe, *windows.observation_range.tolist())

    def network(self, windows: Windows, **options: Any) -> CameraNetwork:
        """A network that sees; options are those of `CameraNetwork`."""
        return CameraNetwork(self.camera(windows), windows.dim, features=self.features, **options)

    def condition(self, c: Tensor, windows: Windows, *, clusters: int) -> EmbeddedClusters:
        """COT Policy's condition: clusters of pictures and proprioception, fitted to scenes c."""
        camera = self.camera(windows)
        condition = PCAKMeansCondition(
            pixels=camera.pixels, components=self.components, clusters=clusters
        )
        return EmbeddedClusters(camera, condition).fit(c)


__getattr__ = renamed(__name__, {"CameraOptions": "cotlearn.policies.training:camera_options"})
