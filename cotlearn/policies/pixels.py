"""Policies that see: a picture and the place of the hand instead of the pose of the T.

The network is a convolutional encoder and a velocity field that is given what the encoder found.
Both are trained end to end by the loss of the flow, and by a second one: the first four features
must be the pose of the T, which is known in training and never shown. The velocity field looks at
the chunk as if from the T, at the pose that the encoder believes in.
"""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor, nn

from cotlearn.couplings import EmbeddedClusters, Pairs, PCAKMeansCondition
from cotlearn.flows.matching import Loss
from cotlearn.flows.networks import ImageEncoder, ResidualMLP
from cotlearn.policies.windows import Windows
from cotlearn.renamed import renamed
from cotlearn.robots.push_t.camera import AGENT, PLACE, SCENE, TURN, Camera
from cotlearn.robots.push_t.task import GOAL, SIZE
from cotlearn.validation import check_count

POSE = 4  #: x, y, cosine and sine
_UNIT = SIZE / 4  #: a length that counts as 1 in features


class CameraNetwork(nn.Module):
    """v(t, x, c) that looks at a scene c through a camera.

    Args:
        camera: takes the picture; or its attributes, as a file has them.
        dim: d, columns of x, two for each step.
        features: of a picture, beside the pose.
        seed: of the initial weights.
        options: of the velocity field, a `ResidualMLP`.
    """

    def __init__(
        self,
        camera: Camera | dict[str, Any],
        dim: int,
        *,
        features: int = 32,
        seed: int | None = None,
        **options: Any,
    ) -> None:
        super().__init__()
        self.camera = camera if isinstance(camera, Camera) else Camera(**camera)
        self.dim, self.condition_dim = dim, self.camera.observe * SCENE
        self.features = check_count(features, "features", minimum=0)
        self.encoder = ImageEncoder(POSE + features, seed=seed)
        self.head = TurnedMLP(dim, features, self.camera.observe, seed=seed, **options)
        self.sizes: dict[str, Any] = {"camera": asdict(self.camera), "dim": dim}
        self.sizes |= {"features": features, **options}

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor) -> Tensor:
        """The velocity (B, d) at time t, x (B, d) and scenes c (B, k)."""
        return self.head(t, x, self.encode(c))

    def encode(
        self, c: Tensor, *, shift: int = 0, generator: torch.Generator | None = None
    ) -> Tensor:
        """What the velocity field is given of scenes c: features of their pictures, and the hand.

        The first four are the pose: x and y, the middle of the world as 0, cosine and sine. The
        last, observe * 2, are the places of the agent, with the same middle.

        Args:
            c: (B, k).
            shift: pixels by which pictures are shifted at random.
            generator: of the shifts.
        """
        pictures = shifted(self.camera.pictures(c), shift, generator)
        hand = (self.camera.scenes(c)[..., AGENT] - SIZE / 2) / _UNIT
        features = self.encoder(pictures.permute(0, 3, 1, 2).float() / 127.5 - 1)
        return torch.cat([features, hand.flatten(1)], dim=1)

    def pose_error(self, features: Tensor, c: Tensor) -> Tensor:
        """The squared error of the pose, (B,)."""
        now = self.camera.scenes(c)[:, -1]
        pose = torch.cat([(now[:, PLACE] - SIZE / 2) / _UNIT, now[:, TURN]], dim=1)
        return (features[:, :POSE] - pose).square().sum(dim=1)


class TurnedMLP(nn.Module):
    """A `ResidualMLP` that looks from the T, at the pose that the first features state.

    It is given the places of the agent and of the goal as seen from there; chunks x are turned for
    it, and its velocities turned back. It knows nothing of the T but what the features say.

    Args:
        dim: d, two columns for each step of a chunk.
        features: of an encoder, beside the pose.
        observe: places of the agent that follow them, two columns each.
        options: of the `ResidualMLP`.
    """

    def __init__(self, dim: int, features: int, observe: int, **options: Any) -> None:
        super().__init__()
        self.dim, self.condition_dim = dim, POSE + features + 2 * observe
        self.observe = observe
        self.inner = ResidualMLP(dim, 2 * (observe + 2) + features, **options)

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor) -> Tensor:
        """The velocity (B, d) at time t, x (B, d) and features c (B, k)."""
        place, free = c[:, None, :2], c[:, POSE : -2 * self.observe]
        hand = c[:, -2 * self.observe :]
        facing = nn.functional.normalize(c[:, None, 2:POSE], dim=2)
        goal = c.new_tensor([(GOAL[0] - SIZE / 2) / _UNIT, (GOAL[1] - SIZE / 2) / _UNIT])
        wanted = c.new_tensor([math.cos(GOAL[2]), math.sin(GOAL[2])]).expand_as(place)
        places = torch.cat([hand.unflatten(1, (-1, 2)), goal.expand_as(place)], dim=1) - place
        seen = torch.cat([_turned(places, facing, -1), _turned(wanted, facing, -1)], dim=1)
        x = _turned(x.unflatten(1, (-1, 2)), facing, -1).flatten(1)
        velocity = self.inner(t, x, torch.cat([seen.flatten(1), free], dim=1))
        return _turned(velocity.unflatten(1, (-1, 2)), facing, 1).flatten(1)


def _turned(points: Tensor, facing: Tensor, sign: int) -> Tensor:
    """Points (B, n, 2) turned by angles given as their cosines and sines (B, 1, 2), or back."""
    (x, y), (cos, sin) = points.unbind(2), facing.unbind(2)
    sin = sign * sin
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=2)


def turned_with_t(x: Tensor, c: Tensor, *, camera: Camera, sign: int) -> Tensor:
    """Chunks x (B, d) turned as the true T of scenes c (B, k) faces: the frame of `TurnedMLP`.

    With sign -1 they are as seen from the T, with 1 they are turned back: the two functions of
    `couplings.Transformed`. The pose is known where pairs are made, in training, as it is to
    `CameraLoss`.
    """
    facing = nn.functional.normalize(camera.scenes(c)[:, -1:, TURN], dim=2)
    return _turned(x.unflatten(1, (-1, 2)), facing, sign).flatten(1)


@dataclass(frozen=True)
class CameraLoss:
    """A loss of the velocity field on what the encoder makes of a picture, and that of the pose.

    Pictures are shifted at random by up to `shift` pixels, their edges repeated (DrQ, 2004.13649):
    the crop that every published visuomotor policy trains with.

    Attributes:
        loss: of the velocity field, any.
        pose: weight of the pose's squared error; 0 trains on `loss` alone.
        shift: pixels.
    """

    loss: Loss
    pose: float = 1000.0
    shift: int = 0

    def __call__(self, network: Any, pairs: Pairs, generator: torch.Generator) -> Tensor:
        """The loss of each row, (B,), of a `CameraNetwork`; its encoder runs once."""
        assert pairs.c is not None  # scenes
        features = network.encode(pairs.c, shift=self.shift, generator=generator)
        value = self.loss(network.head, replace(pairs, c=features), generator)
        return value + self.pose * network.pose_error(features, pairs.c)


def shifted(pictures: Tensor, most: int, generator: torch.Generator | None = None) -> Tensor:
    """Pictures (B, h, w, 3), each moved by up to `most` pixels both ways, the edges repeated."""
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
