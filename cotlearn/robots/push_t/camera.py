"""What a policy with a camera sees of a scene of Push-T."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.robots.push_t.rasteriser import rasterise

SCENE = 6  #: columns of a scene at one step: agent x, y; T x, y, cosine and sine of its angle
AGENT, PLACE, TURN = slice(0, 2), slice(2, 4), slice(4, 6)


@dataclass(frozen=True)
class Camera:
    """A camera over the world, and the sense that tells an arm where its hand is.

    Pictures are a function of the scene, so the scene is what is stored, and a picture is taken
    whenever one is looked at. Of the scenes (B, observe * 6), as `Windows` has them in the frames
    "agent" and "world", nothing is shown but the picture of the last step, and the places of the
    agent in all of them: never the pose of the T.

    Attributes:
        size: width and height of a picture in pixels.
        observe: steps of a scene.
        low: of the columns of a scene at one step, the values that are -1 in it.
        high: those that are 1.
    """

    size: int
    observe: int
    low: Sequence[float]
    high: Sequence[float]

    @property
    def pixels(self) -> int:
        """Numbers of a picture: size * size * 3."""
        return self.size**2 * 3

    def scenes(self, c: Tensor) -> Tensor:
        """(B, observe, 6) in the units of the world."""
        low, high = torch.tensor([self.low, self.high], dtype=c.dtype, device=c.device)
        return low + (c.view(-1, self.observe, SCENE) + 1) / 2 * (high - low)

    def pictures(self, c: Tensor) -> Tensor:
        """(B, size, size, 3) uint8."""
        now = self.scenes(c)[:, -1]
        angle = torch.atan2(now[:, 5], now[:, 4])
        return rasterise(torch.cat([now[:, :4], angle[:, None]], dim=1), size=self.size)

    def hand(self, c: Tensor) -> Tensor:
        """Proprioception: the places of the agent, scaled as in the scenes, (B, observe * 2)."""
        return c.view(-1, self.observe, SCENE)[..., AGENT].flatten(1)

    def __call__(self, c: Tensor) -> Tensor:
        """Pixels from 0 to 1, flattened, then proprioception: (B, pixels + observe * 2).

        This is all that a policy is shown, as one matrix: what `PCAKMeansCondition` takes.
        """
        pixels = self.pictures(c).flatten(1).to(c.dtype) / 255
        return torch.cat([pixels, self.hand(c)], dim=1)
