"""Write names beside points so that nothing is covered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from cotlearn.plots.style import readable

#: Where a text may stand: a distance from its point in points of an inch, and a direction.
_DISTANCES = np.repeat([8, 14, 22, 32, 44, 58, 76, 98, 124, 150], 8)
_ANGLES = np.deg2rad(np.tile([0, 180, 35, -35, 90, -90, 145, -145], 10))
_DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)]).round(9)
#: The share of the text that lies before its anchor: it grows away from the point.
_SHARES = (1 - np.sign(_DIRECTIONS)) / 2


def place_labels(
    ax: Axes,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    texts: Sequence[str],
    colors: Sequence[str],
) -> None:
    """Write each text near its point, at the nearest of many places that covers nothing yet.

    x and y are (n, 3): low end, value and high end of the error bars.
    """
    figure: Any = ax.figure.get_figure(root=True)
    figure.draw_without_rendering()  # so that the layout is final and pixels mean something
    panel, point = np.array(ax.get_window_extent().extents), figure.dpi / 72
    low, at, high = (ax.transData.transform(np.column_stack([x[:, k], y[:, k]])) for k in range(3))
    taken = np.vstack(  # by markers and bars: rows of left, bottom, right and top
        [
            np.hstack([at - 5 * point, at + 5 * point]),
            np.column_stack([low[:, 0], at[:, 1] - point, high[:, 0], at[:, 1] + point]),
            np.column_stack([at[:, 0] - point, low[:, 1], at[:, 0] + point, high[:, 1]]),
        ]
    )
    for k in np.argsort(-at[:, 1]):
        note = ax.annotate(
            texts[k],
            (x[k, 1], y[k, 1]),
            fontsize=8,
            color=readable(colors[k]),
            in_layout=False,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],  # over lines and bars
            zorder=5,
        )
        size = np.array(note.get_window_extent().size)
        corners = at[k] + point * _DISTANCES[:, None] * _DIRECTIONS - size * _SHARES
        boxes = np.hstack([corners, corners + size])
        covered = _common_area(boxes[:, None], taken).sum(axis=1)
        outside = _common_area(boxes, panel) < 0.999 * size.prod()
        best = np.argmin(_DISTANCES + 10 * covered + 10_000 * outside)
        note.xyann = tuple(_DISTANCES[best] * _DIRECTIONS[best])
        note.anncoords = "offset points"
        note.set(
            ha=("left", "center", "right")[int(2 * _SHARES[best, 0])],
            va=("bottom", "center", "top")[int(2 * _SHARES[best, 1])],
        )
        if _DISTANCES[best] > 14:
            nearest = np.clip(at[k], boxes[best, :2], boxes[best, 2:])
            line = ax.transData.inverted().transform([at[k], nearest])
            ax.add_line(Line2D(*line.T, color=colors[k], lw=0.6, alpha=0.6, zorder=2))
        taken = np.vstack([taken, boxes[best]])


def _common_area(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """The area in pixels that boxes (..., 4) share."""
    low = np.maximum(first[..., :2], second[..., :2])
    high = np.minimum(first[..., 2:], second[..., 2:])
    return np.clip(high - low, 0, None).prod(axis=-1)
