"""Small images, side by side: ink on white, and pictures in colour."""

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


def picture_grid(
    pictures: ArrayLike | Any,
    *,
    columns: int = 8,
    ax: Axes | None = None,
    title: str | None = None,
    row_labels: Sequence[str] | None = None,
    column_labels: Sequence[str] | None = None,
) -> Axes:
    """Tile pictures in colour, row by row.

    Args:
        pictures: (n, height, width, 3), 0 to 255.
        columns: pictures in a row.
        ax: where to draw; a new figure by default.
        title: words above.
        row_labels: words beside the rows.
        column_labels: words below the columns.

    Raises:
        ValueError: a shape does not fit.
    """
    array = as_array(pictures, "pictures")
    if array.ndim != 4 or array.shape[3] != 3 or 0 in array.shape:
        raise ValueError(f"pictures has shape {array.shape}, expected (n, height, width, 3)")
    if columns < 1:
        raise ValueError(f"columns is {columns}, expected at least 1")
    n, height, width, _ = array.shape
    rows = -(-n // columns)
    labels = {"row_labels": (row_labels, rows), "column_labels": (column_labels, columns)}
    for name, (words, wanted) in labels.items():
        if words is not None and len(words) != wanted:
            raise ValueError(f"{name} has {len(words)} entries, expected {wanted}")
    gap = max(1, height // 16)
    canvas = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255.0)
    for index, picture in enumerate(array):
        top, left = (index // columns) * (height + gap), (index % columns) * (width + gap)
        canvas[top : top + height, left : left + width] = picture
    ax = open_axes(ax, (1.05 * columns + 0.8, 1.05 * rows + 0.4))
    ax.imshow(canvas.clip(0, 255).astype(np.uint8), interpolation="nearest")
    middles = [
        np.arange(k) * (side + gap) + side / 2 - 0.5
        for k, side in ((columns, width), (rows, height))
    ]
    ax.set_xticks(middles[0] if column_labels is not None else [], column_labels)
    ax.set_yticks(middles[1] if row_labels is not None else [], row_labels)
    ax.tick_params(length=0)
    ax.grid(visible=False)
    for spine in ax.spines.values():
        spine.set_visible(False)
    if title is not None:
        ax.set_title(title)
    return ax
