"""Write names beside points so that nothing is covered."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from cotlearn.plots.style import readable


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
    figure = ax.figure.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()  # so that the layout is final and pixels mean something
    scale = figure.dpi / 72
    frame = ax.get_window_extent()
    at = ax.transData.transform(np.column_stack([x[:, 1], y[:, 1]]))
    low = ax.transData.transform(np.column_stack([x[:, 0], y[:, 0]]))
    high = ax.transData.transform(np.column_stack([x[:, 2], y[:, 2]]))
    taken = []
    for (left, bottom), (px, py), (right, top) in zip(low, at, high, strict=True):
        taken.append(
            Bbox.from_extents(px - 5 * scale, py - 5 * scale, px + 5 * scale, py + 5 * scale)
        )
        taken.append(Bbox.from_extents(left, py - scale, right, py + scale))
        taken.append(Bbox.from_extents(px - scale, bottom, px + scale, top))
    ways = [
        (distance, np.cos(angle), np.sin(angle))
        for distance in (8, 14, 22, 32, 44, 58, 76, 98, 124, 150)
        for angle in np.deg2rad([0, 180, 35, -35, 90, -90, 145, -145])
    ]
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
        size = note.get_window_extent()

        def box(way: tuple[float, float, float], k: int = k, size: Bbox = size) -> Bbox:
            """Where the text lies that is so far from its point, in such a direction."""
            distance, across, up = way
            left = at[k, 0] + distance * across * scale - size.width * _share(across)
            bottom = at[k, 1] + distance * up * scale - size.height * _share(up)
            return Bbox.from_bounds(left, bottom, size.width, size.height)

        def cost(way: tuple[float, float, float], box: Any = box) -> float:
            here = box(way)
            inside = _area(here, frame) >= 0.999 * here.width * here.height
            covered = sum(_area(here, other) for other in taken)
            return 10_000.0 * (not inside) + 10 * covered + way[0]

        best = min(ways, key=cost)
        distance, across, up = best
        note.xyann = (distance * across, distance * up)
        note.anncoords = "offset points"
        note.set(
            ha={0.0: "left", 0.5: "center", 1.0: "right"}[_share(across)],
            va={0.0: "bottom", 0.5: "center", 1.0: "top"}[_share(up)],
        )
        if distance > 14:
            ends = np.clip(at[k], box(best).p0, box(best).p1)  # the text's nearest point
            line = ax.transData.inverted().transform([at[k], ends])
            ax.add_line(Line2D(*line.T, color=colors[k], lw=0.6, alpha=0.6, zorder=2))
        taken.append(box(best))


def _share(direction: float) -> float:
    """The share of a text that lies before its anchor, for a direction away from its point."""
    return 0.5 if abs(direction) < 1e-6 else 0.0 if direction > 0 else 1.0


def _area(first: Bbox, second: Bbox) -> float:
    """The area in pixels that two boxes share."""
    width = min(first.x1, second.x1) - max(first.x0, second.x0)
    height = min(first.y1, second.y1) - max(first.y0, second.y0)
    return max(width, 0.0) * max(height, 0.0)
