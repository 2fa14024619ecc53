"""Pictures of Push-T from signed distances: smooth edges, no display, no graphics library."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.push_t import task

Image = NDArray[np.float32]

WHITE, WALL = (255, 255, 255), (211, 211, 211)
OUTLINE, BLOCK = (144, 238, 144), (119, 136, 153)  #: goal and T
AGENT, CROSS = (65, 105, 225), (220, 20, 60)
_BOXES = (task.BAR, (*task.STEM[:2], 0.0, task.STEM[3]))  #: of the T; overlap, to hide the seam
_CROSS = 16.0  #: half of an arm of the cross that marks an action, pixels of the world


def draw(
    state: Sequence[float], *, size: int, action: tuple[float, float] | None = None
) -> NDArray[np.uint8]:
    """Draws the world, y pointing down as in gym-pusht's pictures.

    Args:
        state: agent x and y, T x, y and angle.
        size: width and height of the picture in pixels.
        action: marked by a cross if given.

    Returns:
        (size, size, 3).
    """
    x, y = _grid(size)
    image = _background(size).copy()
    _paint(image, _to_tee(x, y, state[2:]), BLOCK)
    _paint(image, np.hypot(x - state[0], y - state[1]) - task.AGENT_RADIUS, AGENT)
    if action is not None:
        dx, dy = np.abs(x - action[0]), np.abs(y - action[1])
        arms = np.minimum(np.maximum(dx - _CROSS, dy - 2), np.maximum(dx - 2, dy - _CROSS))
        _paint(image, arms, CROSS)
    return np.rint(image).astype(np.uint8)


@functools.lru_cache(maxsize=4)
def _grid(size: int) -> tuple[Image, Image]:
    centres = ((np.arange(size) + 0.5) * (task.SIZE / size)).astype(np.float32)
    y, x = np.meshgrid(centres, centres, indexing="ij")
    return x, y


@functools.lru_cache(maxsize=4)
def _background(size: int) -> Image:
    x, y = _grid(size)
    image = np.empty((size, size, 3), dtype=np.float32)
    image[:] = WHITE
    low, high = task.WALLS
    _paint(image, _to_tee(x, y, task.GOAL), OUTLINE)
    to_line = np.minimum.reduce([abs(x - low), abs(x - high), abs(y - low), abs(y - high)])
    inside = np.maximum.reduce([low - x, x - high, low - y, y - high]) - task.WALL_RADIUS
    _paint(image, np.maximum(to_line - task.WALL_RADIUS, inside), WALL)
    return image


def _paint(image: Image, distance: Image, colour: tuple[int, int, int]) -> None:
    """Blends a colour in where the signed distance is negative, over one pixel at the edge."""
    pixel = task.SIZE / len(image)
    opacity = np.clip(0.5 - distance / pixel, 0.0, 1.0)[..., None]
    image += opacity * (np.array(colour, dtype=np.float32) - image)


def _to_tee(x: Image, y: Image, pose: Sequence[float]) -> Image:
    """Signed distance to a T (inside: a lower bound of its size)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    u = cos * (x - pose[0]) + sin * (y - pose[1])
    v = cos * (y - pose[1]) - sin * (x - pose[0])
    return functools.reduce(np.minimum, (_to_box(u, v, box) for box in _BOXES))


def _to_box(u: Image, v: Image, box: tuple[float, float, float, float]) -> Image:
    x0, x1, y0, y1 = box
    out_x = np.abs(u - (x0 + x1) / 2) - (x1 - x0) / 2
    out_y = np.abs(v - (y0 + y1) / 2) - (y1 - y0) / 2
    outside = np.hypot(np.maximum(out_x, 0), np.maximum(out_y, 0))
    return outside + np.minimum(np.maximum(out_x, out_y), 0)
