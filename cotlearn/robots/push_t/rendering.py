"""A picture of Push-T, with the action marked in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from cotlearn.robots.push_t.rasteriser import grid, paint, rasterise
from cotlearn.robots.push_t.task import SIZE

CROSS = (220, 20, 60)
_ARM, _STROKE = 16.0, 2.0  #: half of an arm of the cross, and of its width


def draw(
    state: Sequence[float] | NDArray[np.float64],
    *,
    size: int,
    action: tuple[float, float] | None = None,
) -> NDArray[np.uint8]:
    """Draws the world, y pointing down as in gym-pusht's pictures; see `rasterise` for many.

    Args:
        state: agent x and y, T x, y and angle.
        size: width and height of the picture in pixels.
        action: marked by a cross if given.

    Returns:
        (size, size, 3).
    """
    picture = rasterise(np.array([state], dtype=np.float64), size=size)[0]
    if action is not None:
        x, y = grid(size)
        right, down = (x - action[0]).abs(), (y - action[1]).abs()
        across = torch.maximum(right - _ARM, down - _STROKE)
        arms = torch.minimum(across, torch.maximum(right - _STROKE, down - _ARM))
        image = paint(picture.permute(2, 0, 1).float(), arms, CROSS, pixel=SIZE / size)
        picture = image.round_().to(torch.uint8).permute(1, 2, 0)
    return np.ascontiguousarray(picture.numpy())
