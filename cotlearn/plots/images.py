"""Tiles of small images: grey values and colour images."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from cotlearn.plots._canvas import Array, Numbers, as_array, open_axes


def image_grid(images: Numbers, *, row_labels: Sequence[str], title: str = "") -> Axes:
    """Tile images of 8 x 8 pixels, ten a row, dark ink on white.

    Args:
        images: (n, 64) with values in [-1, 1], 1 being ink.
        row_labels: labels beside the rows.
        title: title of the figure.
    """
    ink = as_array(images, "n", 64).reshape(-1, 8, 8, 1)
    ax = _tile(127.5 * (1 - ink), 10, row_labels, inches=0.52)
    ax.set_title(title)
    return ax


def picture_grid(pictures: Numbers, *, columns: int, row_labels: Sequence[str]) -> Axes:
    """Tile pictures in colour, row by row.

    Args:
        pictures: (n, height, width, 3), 0 to 255.
        columns: pictures in a row.
        row_labels: labels beside the rows.
    """
    return _tile(as_array(pictures, "n", "height", "width", 3), columns, row_labels, inches=1.05)


def _tile(tiles: Array, columns: int, row_labels: Sequence[str], *, inches: float) -> Axes:
    """Tiles (n, height, width, colours), 0 to 255, with white between them."""
    n, height, width, _ = tiles.shape
    rows, gap = -(-n // columns), max(1, height // 16)
    down, across, missing = height + gap, width + gap, rows * columns - n
    margins = ((0, missing), (0, gap), (0, gap), (0, 0))
    framed = np.pad(tiles.clip(0, 255).astype(np.uint8), margins, constant_values=255)
    grid = framed.reshape(rows, columns, down, across, -1).swapaxes(1, 2)
    picture = grid.reshape(rows * down, columns * across, -1)[:-gap, :-gap]
    ax = open_axes(None, (inches * columns + 1.0, inches * rows + 0.4))
    ax.imshow(picture, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    middles = np.arange(rows) * down + height / 2 - 0.5
    ax.set(xticks=[], yticks=middles, yticklabels=row_labels)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    return ax
