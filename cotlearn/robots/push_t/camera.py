"""The observations of a Push-T policy with a camera: images and proprioception."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.robots.push_t.rasteriser import rasterise
from cotlearn.validation import check_array, check_count

SCENE = 6  #: columns of a scene at one step: agent x, y; T x, y, cosine and sine of its angle
LARGEST = 1024  #: width of an image in pixels; a policy's file could name any
AGENT, PLACE, TURN = slice(0, 2), slice(2, 4), slice(4, 6)


@dataclass(frozen=True)
class Camera:
    """A camera above the world, with proprioception of the agent's position.

    Images are a function of the scene, so scenes are stored, and images are rendered when they are
    needed. Scenes c (B, observe * 6) are conditions of `Windows` in the frames "agent" and "world".
    A policy is given only the image of the last step and the agent's positions in all steps, never
    the pose of the T.

    Attributes:
        size: width and height of an image in pixels, at most 1,024.
        observe: steps of a scene.
        low: (6,), the values of a step's columns that are scaled to -1.
        high: (6,), the values that are scaled to 1.

    Raises:
        ValueError: a number is out of range, or low or high has another shape.
    """

    size: int
    observe: int
    low: Sequence[float]
    high: Sequence[float]

    def __post_init__(self) -> None:
        check_count(self.size, "size", most=LARGEST)
        check_count(self.observe, "observe")
        for name in ("low", "high"):
            check_array(getattr(self, name), name, (SCENE,))

    @property
    def pixels(self) -> int:
        """Numbers in an image: size * size * 3."""
        return self.size**2 * 3

    def scenes(self, c: Tensor) -> Tensor:
        """Scenes c as (B, observe, 6) in world units."""
        low, high = torch.tensor([self.low, self.high], dtype=c.dtype, device=c.device)
        return low + (c.view(-1, self.observe, SCENE) + 1) / 2 * (high - low)

    def pictures(self, c: Tensor) -> Tensor:
        """Images (B, size, size, 3), uint8, of the last step of scenes c."""
        now = self.scenes(c)[:, -1]
        angle = torch.atan2(now[:, 5], now[:, 4])
        return rasterise(torch.cat([now[:, :4], angle[:, None]], dim=1), size=self.size)

    def hand(self, c: Tensor) -> Tensor:
        """Proprioception: the agent's positions, scaled as in scenes c, (B, observe * 2)."""
        return c.view(-1, self.observe, SCENE)[..., AGENT].flatten(1)

    def __call__(self, c: Tensor) -> Tensor:
        """Flattened pixels from 0 to 1, then proprioception: (B, pixels + observe * 2).

        This matrix is everything that a policy observes, in the form that `PCAKMeansCondition`
        takes.
        """
        pixels = self.pictures(c).flatten(1).to(c.dtype) / 255
        return torch.cat([pixels, self.hand(c)], dim=1)
