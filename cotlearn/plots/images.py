"""Small images, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_array
from cotlearn.plots._canvas import open_axes


def image_grid(
    images: ArrayLike | Any,
    *,
    columns: int = 10,
    side: int = 8,
    ax: Axes | None = None,
    title: str | None = None,
    row_labels: Sequence[str] | None = None,
) -> Axes:
    """Tile small square images, row by row, dark ink on white.

    Args:
        images: (n, side * side) or (n, side, side) with values in [-1, 1], 1 being ink.
        columns: images in a row.
        side: pixels a side.
        ax: where to draw; a new figure by default.
        title: words above.
        row_labels: words beside the rows.

    Raises:
        ValueError: a shape does not fit.
    """
    array = as_array(images, "images")
    if array.ndim == 2 and array.shape[1] == side * side:
        array = array.reshape(-1, side, side)
    if array.ndim != 3 or array.shape[1:] != (side, side) or len(array) < 1:
        raise ValueError(
            f"images has shape {array.shape}, expected (n, {side * side}) or (n, {side}, {side})"
        )
    if columns < 1:
        raise ValueError(f"columns is {columns}, expected at least 1")
    rows = -(-len(array) // columns)
    if row_labels is not None and len(row_labels) != rows:
        raise ValueError(f"row_labels has {len(row_labels)} entries, expected {rows}")
    cell = side + 1
    canvas = np.full((rows * cell - 1, columns * cell - 1), -1.0)
    for index, image in enumerate(array):
        top, left = (index // columns) * cell, (index % columns) * cell
        canvas[top : top + side, left : left + side] = image
    ax = open_axes(ax, (0.52 * columns + 1.0, 0.52 * rows + 0.4))
    ax.imshow(canvas, cmap="gray_r", vmin=-1, vmax=1, interpolation="nearest")
    ax.set_xticks([])
    if row_labels is None:
        ax.set_yticks([])
    else:
        ax.set_yticks([r * cell + side / 2 - 0.5 for r in range(rows)], list(row_labels))
        ax.tick_params(axis="y", length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    if title is not None:
        ax.set_title(title)
    return ax
