"""Potentials and their maps: contours, a net that a map bends, outlines of what it makes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_array, as_classes, as_path
from cotlearn.plots._canvas import finish_plane, open_plane
from cotlearn.plots.style import COLORS, SOURCE_COLOR, condition_colors


def contours(
    across: ArrayLike | Any,
    up: ArrayLike | Any,
    height: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    levels: int = 14,
) -> Axes:
    """Draw a function of the plane as a map with contour lines, dark where it is low.

    Args:
        across: (m,) rising first coordinates.
        up: (n,) rising second coordinates.
        height: (n, m) values, one row for each of ``up``.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        levels: about so many contour lines.

    Raises:
        ValueError: a shape does not fit, or a height is not finite.
    """
    x, y, z = as_array(across, "across"), as_array(up, "up"), as_array(height, "height")
    if x.ndim != 1 or y.ndim != 1 or z.shape != (y.size, x.size) or min(z.shape) < 2:
        raise ValueError(
            f"height has shape {z.shape}, expected (n, m) with up {y.shape} and across {x.shape}"
        )
    for name, values in (("across", x), ("up", y), ("height", z)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} has values that are not finite")
    ax = open_plane(ax)
    ax.contourf(x, y, z, levels=levels, cmap="cividis", alpha=0.85)
    ax.contour(x, y, z, levels=levels, colors="white", linewidths=0.6)
    finish_plane(ax, title, None).set_aspect("equal", adjustable="box")
    ax.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()))
    return ax


def net(
    knots: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
    color: str = SOURCE_COLOR,
) -> Axes:
    """Draw a net whose knots are points of the plane: a grid, or what a map makes of it.

    Args:
        knots: (rows, columns, 2) places of the knots.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.
        color: of the threads.

    Raises:
        ValueError: not (rows, columns, 2) with two rows and two columns or more.
    """
    array = as_path(knots, "knots")
    if array.shape[1] < 2:
        raise ValueError(f"knots has shape {array.shape}, expected two columns or more")
    ax = open_plane(ax)
    threads = [*array, *array.transpose(1, 0, 2)]
    ax.add_collection(LineCollection(threads, colors=color, linewidths=0.7, alpha=0.8))
    ax.autoscale_view()
    return finish_plane(ax, title, limit)


def outlines(
    curves: ArrayLike | Any,
    c: ArrayLike | Any = None,
    *,
    truth: ArrayLike | Any = None,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
) -> Axes:
    """Draw closed curves coloured by their condition, over the true ones, dotted and black.

    Say the image of one circle under the map of each condition.

    Args:
        curves: (n, K, 2), n points of each of K curves in order; the last is joined to the first.
        c: the condition of each curve, as in :func:`scatter`: K rows.
        truth: (m, K, 2) points of the true curves, or None.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.

    Raises:
        ValueError: a shape does not fit.
    """
    array = as_path(curves, "curves")
    values, n_classes = as_classes(c, array.shape[1])
    dotted = None if truth is None else as_path(truth, "truth")
    if dotted is not None and dotted.shape[1] != array.shape[1]:
        raise ValueError(f"truth has {dotted.shape[1]} curves, expected {array.shape[1]}")
    ax = open_plane(ax)
    colors = condition_colors(values, n_classes, plain=COLORS["independent"])
    closed = np.concatenate([array, array[:1]]).transpose(1, 0, 2)
    ax.add_collection(LineCollection(list(closed), colors=colors, linewidths=1.8))
    if dotted is not None:
        closed = np.concatenate([dotted, dotted[:1]]).transpose(1, 0, 2)
        look: dict[str, Any] = {"colors": COLORS["truth"], "linestyles": ":", "linewidths": 1.2}
        ax.add_collection(LineCollection(list(closed), **look))
    ax.autoscale_view()
    return finish_plane(ax, title, limit)
