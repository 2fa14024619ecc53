"""Small images, side by side: ink on white, and pictures in colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from cotlearn.plots._arrays import as_array
from cotlearn.plots._canvas import open_axes


def image_grid(images: ArrayLike | Any, *, row_labels: Sequence[str], title: str = "") -> Axes:
    """Tile images of 8 x 8 pixels, ten a row, dark ink on white.

    Args:
        images: (n, 64) with values in [-1, 1], 1 being ink.
        row_labels: words beside the rows.
        title: words above.
    """
    tiles = as_array(images, "n", 64).reshape(-1, 8, 8)
    look = {"cmap": "gray_r", "vmin": -1, "vmax": 1}
    return _tile(tiles, 10, row_labels, inches=0.52, blank=-1, title=title, **look)


def picture_grid(pictures: ArrayLike | Any, *, columns: int, row_labels: Sequence[str]) -> Axes:
    """Tile pictures in colour, row by row.

    Args:
        pictures: (n, height, width, 3), 0 to 255.
        columns: pictures in a row.
        row_labels: words beside the rows.
    """
    tiles = as_array(pictures, "n", "height", "width", 3).clip(0, 255).astype(np.uint8)
    return _tile(tiles, columns, row_labels, inches=1.05, blank=255)


def _tile(
    tiles: NDArray[Any],
    columns: int,
    row_labels: Sequence[str],
    *,
    inches: float,
    blank: float,
    title: str = "",
    **look: Any,
) -> Axes:
    n, height, width = tiles.shape[:3]
    rows, gap = -(-n // columns), max(1, height // 16)
    down, across = height + gap, width + gap
    canvas = np.full((rows * down - gap, columns * across - gap, *tiles.shape[3:]), blank)
    canvas = canvas.astype(tiles.dtype)
    for index, tile in enumerate(tiles):
        top, left = index // columns * down, index % columns * across
        canvas[top : top + height, left : left + width] = tile
    ax = open_axes(None, (inches * columns + 1.0, inches * rows + 0.4))
    ax.imshow(canvas, interpolation="nearest", **look)
    ax.set_xticks([])
    ax.set_yticks(np.arange(rows) * down + height / 2 - 0.5, row_labels)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.set_title(title)
    return ax
