"""Which noise met which data: lines between partners, and the skew that a coupling leaves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from numpy.typing import ArrayLike, NDArray

from cotlearn.plots._arrays import as_classes, as_points
from cotlearn.plots._canvas import finish_plane, legend_beside, open_plane, panels
from cotlearn.plots.points import scatter
from cotlearn.plots.style import PATH_COLOR, SOURCE_COLOR, condition_color, condition_colors


def pair_lines(
    x0: ArrayLike | Any,
    x1: ArrayLike | Any,
    c: ArrayLike | Any = None,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
    size: float = 14.0,
    legend: bool = False,
) -> Axes:
    """Draw a coupling: a line from each source point to the data point it was paired with.

    Args:
        x0: (n, 2) source points.
        x1: (n, 2) data points, row by row the partners of ``x0``.
        c: conditions of the data, as in :func:`scatter`; the lines take their colours.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.
        size: marker area in points squared.
        legend: as in :func:`scatter`.

    Raises:
        ValueError: a shape does not fit.
    """
    start = as_points(x0, "x0")
    end = as_points(x1, "x1", rows=len(start))
    values, n_classes = as_classes(c, len(start))
    ax = open_plane(ax, legend=legend)
    colors = condition_colors(values, n_classes, plain=PATH_COLOR)
    lines = list(np.stack([start, end], axis=1))
    ax.add_collection(LineCollection(lines, colors=colors, linewidths=0.7, alpha=0.5, zorder=0))
    return scatter(end, c, x0=start, ax=ax, title=title, limit=limit, size=size, legend=legend)


def paired_source(
    x0: ArrayLike | Any,
    c: ArrayLike | Any,
    *,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = 3.6,
    size: float = 7.0,
    legend: bool = False,
    condition_label: str = "condition $c$",
) -> Axes:
    """Show skew: source points coloured by the condition they were paired with.

    Without skew the colours are mixed everywhere; with skew each condition owns a region of the
    noise.

    Args:
        x0: (n, 2) source points.
        c: the condition each of them was paired with, as in :func:`scatter`.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit.
        size: marker area in points squared.
        legend: as in :func:`scatter`.
        condition_label: words beside the colour bar of a continuous condition.

    Raises:
        ValueError: a shape does not fit.
    """
    points = as_points(x0, "x0")
    order = np.random.default_rng(0).permutation(len(points))  # no class on top of another
    values, n_classes = as_classes(c, len(points))
    if values is None:
        raise ValueError("c is None, expected the condition of each source point")
    if not n_classes:
        return scatter(
            points[order],
            values[order],
            ax=ax,
            title=title,
            limit=limit,
            size=size,
            legend=legend,
            condition_label=condition_label,
        )
    ax = open_plane(ax, legend=legend)
    if legend:
        for k in range(n_classes):
            ax.scatter([], [], color=condition_color(k), s=size, label=f"c = {k}")
        legend_beside(ax)
    colors = condition_colors(values[order], n_classes, plain=SOURCE_COLOR)
    ax.scatter(points[order, 0], points[order, 1], c=colors, s=size, alpha=0.75, linewidths=0)
    return finish_plane(ax, title, limit)


def source_given_condition(
    x0: ArrayLike | Any,
    c: ArrayLike | Any,
    *,
    axes: Sequence[Axes] | NDArray[Any] | None = None,
    labels: Sequence[str] | None = None,
    limit: float = 3.6,
    size: float = 7.0,
    title: str | None = None,
) -> NDArray[Any]:
    """Draw p(x0 | c) one panel a class: the paired noise in colour, all the other noise faint.

    The thin circle has radius 2: a standard normal in the plane keeps 86 % of its samples inside.

    Args:
        x0: (n, 2) source points.
        c: classes, one-hot (n, K) or integers (n,), that they were paired with.
        axes: one Axes for each class; a new row of panels by default.
        labels: words for the classes.
        limit: both axes run from -limit to limit.
        size: marker area in points squared.
        title: words in front of the first panel's title.

    Returns:
        The array of Axes.

    Raises:
        ValueError: a shape does not fit, or c is continuous.
    """
    points = as_points(x0, "x0")
    values, n_classes = as_classes(c, len(points))
    if not n_classes or values is None:
        raise ValueError(
            "c must be discrete: one-hot (n, K) or integers (n,); cut values into bins"
        )
    if labels is not None and len(labels) != n_classes:
        raise ValueError(f"labels has {len(labels)} entries, expected {n_classes}")
    if axes is None:
        _, axes = panels(n_classes, size=2.3, shared=True)
    grid = np.asarray(axes, dtype=object).ravel()
    if len(grid) != n_classes:
        raise ValueError(f"axes has {len(grid)} panels, expected {n_classes}")
    for k, ax in enumerate(grid):
        rows = values == k
        ax.scatter(*points[~rows].T, color="#d0d0d0", s=size * 0.5, linewidths=0, alpha=0.6)
        ax.scatter(*points[rows].T, color=condition_color(k), s=size, linewidths=0, alpha=0.85)
        ax.add_patch(Circle((0, 0), 2.0, fill=False, color=SOURCE_COLOR, lw=0.8, alpha=0.7))
        words = f"c = {k}" if labels is None else labels[k]
        finish_plane(ax, f"{title}: {words}" if title and k == 0 else words, limit)
    return grid
