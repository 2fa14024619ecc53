"""Functions of the plane: velocity fields, potentials, images of grids and curves under maps."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from cotlearn.plots._canvas import Numbers, as_array, finish_plane, open_plane
from cotlearn.plots.style import COLORS, SOURCE_COLOR, condition_colors


def velocity_field(
    points: Numbers, velocity: Numbers, *, ax: Axes | None = None, limit: float | None = None
) -> Axes:
    """Draw arrows: the velocity at each point, all on one scale.

    Args:
        points: (n, 2) places.
        velocity: (n, 2) velocities there.
        ax: Axes to draw into; a new figure by default.
        limit: both axes run from -limit to limit.
    """
    places, arrows = as_array(points, "n", 2).T, as_array(velocity, "n", 2).T
    ax = open_plane(ax)
    ax.quiver(*places, *arrows, color=SOURCE_COLOR, width=0.0045, alpha=0.85, pivot="mid")
    return finish_plane(ax, "", limit)


def contours(across: Numbers, up: Numbers, height: Numbers, *, title: str = "") -> Axes:
    """Draw a function of the plane as a map with contour lines, dark where it is low.

    Args:
        across: (m,) rising first coordinates.
        up: (n,) rising second coordinates.
        height: (n, m) values, one row for each of ``up``.
        title: title of the panel.
    """
    x, y, z = as_array(across), as_array(up), as_array(height)
    ax = open_plane(None)
    ax.contourf(x, y, z, levels=14, cmap="cividis", alpha=0.85)
    ax.contour(x, y, z, levels=14, colors="white", linewidths=0.6)
    finish_plane(ax, title, None).set_aspect("equal", adjustable="box")
    ax.set(xlim=(x.min(), x.max()), ylim=(y.min(), y.max()))
    return ax


def net(
    knots: Numbers,
    *,
    ax: Axes | None = None,
    title: str = "",
    limit: float | None = None,
    color: str = SOURCE_COLOR,
) -> Axes:
    """Draw a grid, or its image under a map, by its nodes.

    Args:
        knots: (rows, columns, 2) places of the knots.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
        limit: both axes run from -limit to limit.
        color: color of the lines.
    """
    array = as_array(knots, "rows", "columns", 2)
    ax = open_plane(ax)
    threads = [*array, *array.swapaxes(0, 1)]
    ax.add_collection(LineCollection(threads, colors=color, linewidths=0.7, alpha=0.8))
    ax.autoscale_view()
    return finish_plane(ax, title, limit)


def outlines(
    curves: Numbers,
    c: Numbers,
    *,
    truth: Numbers,
    ax: Axes | None = None,
    title: str = "",
    limit: float | None = None,
) -> Axes:
    """Draw closed curves coloured by their condition, over the true ones, dotted and black.

    Say the image of one circle under the map of each condition.

    Args:
        curves: (n, K, 2), n points of each of K curves in order; the last is joined to the first.
        c: the condition of each curve, as in :func:`scatter`: K rows.
        truth: (m, K, 2) points of the true curves.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
        limit: both axes run from -limit to limit.
    """
    learned, true = as_array(curves, "n", "K", 2), as_array(truth, "m", "K", 2)
    colors = condition_colors(c, learned.shape[1])
    ax = open_plane(ax)
    for array, look in (
        (learned, {"colors": colors, "linewidths": 1.8}),
        (true, {"colors": COLORS["truth"], "linestyles": ":", "linewidths": 1.2}),
    ):
        closed = np.concatenate([array, array[:1]]).swapaxes(0, 1)
        ax.add_collection(LineCollection(list(closed), **look))
    ax.autoscale_view()
    return finish_plane(ax, title, limit)
