"""How samples move: their paths, and the velocity that moves them."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_classes, as_path, as_points
from cotlearn.plots._canvas import finish_plane, open_plane
from cotlearn.plots.points import scatter
from cotlearn.plots.style import PATH_COLOR, SOURCE_COLOR


def trajectories(
    path: ArrayLike | Any,
    c: ArrayLike | Any = None,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
    size: float = 9.0,
    legend: bool = False,
) -> Axes:
    """Draw the way of each sample from noise (dark) to its end (coloured by c), paths faint.

    Args:
        path: (times, n, 2), as ``integrate(..., trajectory=True).trajectory``.
        c: as in :func:`scatter`, one row a sample.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.
        size: marker area in points squared.
        legend: as in :func:`scatter`.

    Raises:
        ValueError: a shape does not fit.
    """
    array = as_path(path, "path")
    as_classes(c, array.shape[1])
    ax = open_plane(ax, legend=legend)
    lines = LineCollection(
        list(array.transpose(1, 0, 2)), colors=PATH_COLOR, linewidths=0.6, alpha=0.35, zorder=0
    )
    ax.add_collection(lines)
    return scatter(
        array[-1], c, x0=array[0], ax=ax, title=title, limit=limit, size=size, legend=legend
    )


def velocity_field(
    points: ArrayLike | Any,
    velocity: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
    color: str = SOURCE_COLOR,
) -> Axes:
    """Draw arrows: the velocity at each point, all on one scale.

    Args:
        points: (n, 2) places.
        velocity: (n, 2) velocities there.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.
        color: colour of the arrows.

    Raises:
        ValueError: a shape does not fit.
    """
    places = as_points(points, "points")
    arrows = as_points(velocity, "velocity", rows=len(places))
    ax = open_plane(ax)
    ax.quiver(*places.T, *arrows.T, color=color, width=0.0045, alpha=0.85, pivot="mid")
    return finish_plane(ax, title, limit)
