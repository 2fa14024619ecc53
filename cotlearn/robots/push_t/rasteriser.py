"""Renders many states of Push-T at once from signed distances, without a graphics library.

A pixel takes the share clip(1/2 - d, 0, 1) of a shape's colour, where d is the signed distance from
the pixel's centre to the shape's edge in pixels. This is about the share of the pixel that the
shape covers, so a shape that moves by a tenth of a pixel changes the image, and 48 x 48 such pixels
show more than 48 x 48 binary ones.
"""

import functools

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.robots.push_t import constants
from cotlearn.validation import check_count, check_matrix, check_real

Colour = tuple[int, int, int]

WHITE, WALL = (255, 255, 255), (211, 211, 211)
OUTLINE, BLOCK = (144, 238, 144), (119, 136, 153)  #: goal and T
AGENT = (65, 105, 225)
CROSS = (220, 20, 60)
_ARM, _STROKE = 16.0, 2.0  #: half of an arm of the cross that marks an action, and of its width
#: The T's rectangles, x1 and y0, y1; both are symmetric in x, and overlap to hide the seam.
_RECTANGLES = ((constants.BAR[1], *constants.BAR[2:]), (constants.STEM[1], 0.0, constants.STEM[3]))
#: Pixels that are painted at once; a block that fits a core's cache is faster.
_AT_ONCE = 2**18


def rasterise(states: ArrayLike | Tensor, *, size: int = 96) -> Tensor:
    """Renders states, with y pointing down as in gym-pusht's images.

    Args:
        states: (n, 5), agent x and y, T x, y and angle.
        size: width and height of an image in pixels.

    Returns:
        (n, size, size, 3) uint8, on the device of the states.
    """
    values = states if isinstance(states, Tensor) else torch.tensor(check_real(states, "states"))
    values = values if values.is_complex() else values.float()
    if values.shape != (0, 5):  # no states, no images
        check_matrix(values, "states", columns=5)
    check_count(size, "size")
    image = torch.empty(len(values), 3, size, size, dtype=torch.uint8, device=values.device)
    rows = max(1, _AT_ONCE // size**2)
    for part, some in zip(image.split(rows), values.split(rows), strict=True):
        part.copy_(_painted(some, size))
    return image.permute(0, 2, 3, 1)


def draw(
    state: ArrayLike, *, size: int, action: tuple[float, float] | None = None
) -> NDArray[np.uint8]:
    """Renders one state, with y pointing down as in gym-pusht's images; see `rasterise` for many.

    Args:
        state: agent x and y, T x, y and angle.
        size: width and height of the image in pixels.
        action: a position to mark by a cross, or None.

    Returns:
        (size, size, 3), uint8.
    """
    picture = rasterise(np.array([state], dtype=np.float64), size=size)[0]
    if action is not None:
        x, y = grid(size)
        right, down = (x - action[0]).abs(), (y - action[1]).abs()
        across = torch.maximum(right - _ARM, down - _STROKE)
        arms = torch.minimum(across, torch.maximum(right - _STROKE, down - _ARM))
        image = paint(picture.permute(2, 0, 1).float(), arms, CROSS)
        picture = image.round_().to(torch.uint8).permute(1, 2, 0)
    return np.ascontiguousarray(picture.numpy())


def paint(image: Tensor, distance: Tensor, colour: Colour) -> Tensor:
    """Paints a colour where the signed distance is negative, antialiased over one pixel.

    Args:
        image: (..., 3, size, size), 0 to 255.
        distance: (..., size, size), in world units.
        colour: red, green and blue.
    """
    share = (
        distance.mul(-1 / (constants.SIZE / image.shape[-1]))
        .add_(0.5)
        .clamp_(0, 1)[..., None, :, :]
    )
    tone = torch.tensor(colour, dtype=image.dtype, device=image.device)[:, None, None]
    return torch.lerp(image, tone, share)


def _painted(states: Tensor, size: int) -> Tensor:
    """Images (n, 3, size, size) with integer values in float32."""
    x, y = (centres.to(states.device) for centres in grid(size))
    image = _background(size).to(states.device)
    image = paint(image, _to_tee(x, y, states[:, 2:]), BLOCK)
    from_x, from_y = x - states[:, 0, None, None], y - states[:, 1, None, None]
    to_agent = torch.hypot(from_x, from_y) - constants.AGENT_RADIUS
    return paint(image, to_agent, AGENT).round_()


@functools.lru_cache(maxsize=8)
def grid(size: int) -> tuple[Tensor, Tensor]:
    """World coordinates of the pixel centres: x (1, size) and y (size, 1)."""
    centres = (torch.arange(size) + 0.5) * (constants.SIZE / size)
    return centres[None], centres[:, None]


@functools.lru_cache(maxsize=8)
def _background(size: int) -> Tensor:
    """The goal and the walls, (3, size, size)."""
    x, y = grid(size)
    image = torch.tensor(WHITE, dtype=torch.float32)[:, None, None].expand(3, size, size)
    image = paint(image, _to_tee(x, y, torch.tensor([constants.GOAL]))[0], OUTLINE)
    low, high = constants.WALLS
    lines = [abs(value - end) for value in (x, y) for end in (low, high)]
    to_line = functools.reduce(torch.minimum, lines)
    outside = functools.reduce(torch.maximum, (low - x, x - high, low - y, y - high))
    return paint(image, torch.maximum(to_line, outside) - constants.WALL_RADIUS, WALL)


def _to_tee(x: Tensor, y: Tensor, pose: Tensor) -> Tensor:
    """Signed distances (n, size, size) to Ts with poses (n, 3); lower bounds near corners."""
    place, angle = pose[:, :2, None, None], pose[:, 2, None, None]
    cos, sin = torch.cos(angle), torch.sin(angle)
    x, y = x - place[:, 0], y - place[:, 1]
    across, along = (cos * x + sin * y).abs_(), cos * y - sin * x
    parts = []
    for half, first, last in _RECTANGLES:
        middle = (along - (first + last) / 2).abs_().sub_((last - first) / 2)
        parts.append(torch.maximum(across - half, middle))
    return torch.minimum(*parts)
