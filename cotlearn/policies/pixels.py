"""Visuomotor policies: they observe an image and the agent's position, not the pose of the T.

The network is a convolutional encoder and a velocity field that takes the encoder's features. Both
are trained end to end by the loss of the flow and by a second loss: the first four features must
predict the pose of the T, which is known in training but not an input. The velocity field works in
the frame of the T at the predicted pose.
"""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Generator, Tensor, nn

from cotlearn.couplings import EmbeddedClusters, Pairs, PCAKMeansCondition
from cotlearn.flows.matching import Loss
from cotlearn.flows.networks import ImageEncoder, ResidualMLP
from cotlearn.flows.one_step import MeanVelocity
from cotlearn.policies.windows import Windows
from cotlearn.robots.push_t.camera import AGENT, PLACE, SCENE, TURN, Camera
from cotlearn.robots.push_t.constants import GOAL, SIZE
from cotlearn.validation import check_count

POSE = 4  #: features of the pose: x, y, cosine and sine
_UNIT = SIZE / 4  #: unit of length in the features, pixels


class CameraNetwork(nn.Module):
    """A velocity field v(t, x, c) that observes the scene c through a camera.

    Args:
        camera: a `Camera`, or its attributes as a dictionary.
        dim: d, columns of x, two for each step.
        features: number of image features beside the pose.
        mean: whether to predict mean velocities; the head is a `MeanVelocity` then.
        seed: of the initial weights.
        options: of the velocity field, a `ResidualMLP`.
    """

    def __init__(
        self,
        camera: Camera | dict[str, Any],
        dim: int,
        *,
        features: int = 32,
        mean: bool = False,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__()
        self.camera = camera if isinstance(camera, Camera) else Camera(**camera)
        self.dim, self.condition_dim = dim, self.camera.observe * SCENE
        self.encoder = ImageEncoder(POSE + check_count(features, "features", minimum=0), seed=seed)
        head = TurnedMLP(dim, features, self.camera.observe, int(mean), seed=seed, **options)
        self.head = MeanVelocity(head) if mean else head
        self.sizes: dict[str, Any] = {"camera": asdict(self.camera), "dim": dim}
        self.sizes |= {"features": features, "mean": mean, **options}

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor) -> Tensor:
        """The velocity (B, d) at time t, x (B, d) and scenes c (B, k)."""
        return self.head(t, x, self.encode(c))

    def encode(self, c: Tensor, *, shift: int = 0, generator: Generator | None = None) -> Tensor:
        """Encode scenes as the condition of the velocity field: image features and proprioception.

        The first four columns are the predicted pose: x and y relative to the middle of the world,
        cosine and sine. The last observe * 2 columns are the agent's positions, also relative to
        the middle.

        Args:
            c: (B, k), scenes.
            shift: largest random shift of the images, in pixels.
            generator: of the shifts.

        Returns:
            (B, 4 + features + observe * 2).
        """
        pictures = shifted(self.camera.pictures(c), shift, generator)
        hand = (self.camera.scenes(c)[..., AGENT] - SIZE / 2) / _UNIT
        features = self.encoder(pictures.permute(0, 3, 1, 2).float() / 127.5 - 1)
        return torch.cat([features, hand.flatten(1)], dim=1)

    def pose_error(self, features: Tensor, c: Tensor) -> Tensor:
        """Squared error (B,) of the pose in `features` against the true pose in scenes c."""
        now = self.camera.scenes(c)[:, -1]
        pose = torch.cat([(now[:, PLACE] - SIZE / 2) / _UNIT, now[:, TURN]], dim=1)
        return (features[:, :POSE] - pose).square().sum(dim=1)


class TurnedMLP(nn.Module):
    """A `ResidualMLP` that works in the frame of the T, at the pose in the first four features.

    Its inputs are the positions of the agent and the goal in that frame; chunks x are rotated into
    the frame, and velocities are rotated back. The pose in the features is all it knows of the T.

    Args:
        dim: d, two columns for each step of a chunk.
        features: number of image features beside the pose.
        observe: number of agent positions after the features, two columns each.
        columns: number of further columns after these, such as the length of a jump.
        options: of the `ResidualMLP`.
    """

    def __init__(self, dim: int, features: int, observe: int, columns: int = 0, **options: Any):
        super().__init__()
        self.parts = [POSE, features, 2 * observe, columns]
        self.dim, self.condition_dim = dim, sum(self.parts)
        self.inner = ResidualMLP(dim, 2 * (observe + 2) + features + columns, **options)

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor) -> Tensor:
        """The velocity (B, d) at time t, x (B, d) and features c (B, k)."""
        pose, free, hand, more = c.split(self.parts, dim=1)
        place, facing = pose[:, None, :2], nn.functional.normalize(pose[:, None, 2:], dim=2)
        goal = c.new_tensor([(GOAL[0] - SIZE / 2) / _UNIT, (GOAL[1] - SIZE / 2) / _UNIT])
        wanted = c.new_tensor([math.cos(GOAL[2]), math.sin(GOAL[2])]).expand_as(place)
        places = torch.cat([hand.unflatten(1, (-1, 2)), goal.expand_as(place)], dim=1) - place
        seen = torch.cat([_turned(places, facing, -1), _turned(wanted, facing, -1)], dim=1)
        x = _turned(x.unflatten(1, (-1, 2)), facing, -1).flatten(1)
        velocity = self.inner(t, x, torch.cat([seen.flatten(1), free, more], dim=1))
        return _turned(velocity.unflatten(1, (-1, 2)), facing, 1).flatten(1)


def _turned(points: Tensor, facing: Tensor, sign: int) -> Tensor:
    """Rotate points (B, n, 2) by angles given as cosines and sines (B, 1, 2); sign -1 inverts."""
    (x, y), (cos, sin) = points.unbind(2), (facing * facing.new_tensor([1, sign])).unbind(2)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=2)


@dataclass(frozen=True)
class CameraLoss:
    """The sum of a velocity field's loss on encoded images and of the pose's weighted error.

    Images are shifted at random by up to `shift` pixels, with repeated edges (DrQ, 2004.13649), a
    common augmentation of visuomotor policies.

    Attributes:
        loss: any loss of the velocity field.
        pose: weight of the pose's squared error; 0 trains on `loss` alone.
        shift: largest random shift, in pixels.
    """

    loss: Loss
    pose: float = 1000.0
    shift: int = 0

    def __call__(self, network: Any, pairs: Pairs, generator: Generator) -> Tensor:
        """The loss of each row, (B,), of a `CameraNetwork`, whose encoder runs once per batch."""
        assert pairs.c is not None  # scenes
        features = network.encode(pairs.c, shift=self.shift, generator=generator)
        value = self.loss(network.head, replace(pairs, c=features), generator)
        return value + self.pose * network.pose_error(features, pairs.c)


def shifted(pictures: Tensor, most: int, generator: Generator | None = None) -> Tensor:
    """Shift each image of (B, h, w, 3) by up to `most` pixels along both axes, repeating edges."""
    if not most:
        return pictures
    n, height, width, _ = pictures.shape
    by = torch.randint(-most, most + 1, (2, n, 1), generator=generator).to(pictures.device)
    rows = (torch.arange(height, device=pictures.device) + by[0]).clamp(0, height - 1)
    columns = (torch.arange(width, device=pictures.device) + by[1]).clamp(0, width - 1)
    every = torch.arange(n, device=pictures.device)[:, None, None]
    return pictures[every, rows[:, :, None], columns[:, None, :]]


@dataclass(frozen=True)
class Pixels:
    """Options of a Push-T policy with a camera: `Options(camera=Pixels())`.

    Attributes:
        size: width and height of an image in pixels.
        features: number of image features beside the pose.
        pose: weight of the pose's squared error in the loss, see `CameraLoss`.
        shift: largest random shift of the images in training, in pixels.
        components: principal components of the pixels in the coupling's condition.
        condition_clusters: clusters of COT's condition; stratified OT uses `Options.clusters`.
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
        """Add the loss of the pose to `loss`."""
        return CameraLoss(loss, self.pose, self.shift)

    def camera(self, windows: Windows) -> Camera:
        """The camera for scenes that are scaled like these windows."""
        return Camera(self.size, windows.observe, *windows.observation_range.tolist())

    def network(self, windows: Windows, **options: Any) -> CameraNetwork:
        """A `CameraNetwork` for these windows, with its options."""
        return CameraNetwork(self.camera(windows), windows.dim, features=self.features, **options)

    def condition(self, c: Tensor, windows: Windows, *, clusters: int) -> EmbeddedClusters:
        """COT Policy's condition, clusters of images and proprioception, fitted to scenes c."""
        camera = self.camera(windows)
        condition = PCAKMeansCondition(
            pixels=camera.pixels, components=self.components, clusters=clusters
        )
        return EmbeddedClusters(camera, condition).fit(c)
