"""Samples in the plane."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_classes, as_points
from cotlearn.plots._canvas import finish_plane, legend_beside, open_plane
from cotlearn.plots.style import (
    COLORS,
    CONDITION_MAP,
    SOURCE_COLOR,
    condition_color,
    condition_marker,
)


def scatter(
    x: ArrayLike | Any,
    c: ArrayLike | Any = None,
    *,
    x0: ArrayLike | Any = None,
    ax: Axes | None = None,
    title: str | None = None,
    limit: float | None = None,
    size: float = 7.0,
    condition_label: str = "condition $c$",
    legend: bool = False,
) -> Axes:
    """Scatter points coloured by their condition, with the noise in dark behind them.

    Args:
        x: (n, 2) points.
        c: None, one-hot (n, K), classes (n,), or continuous (n, 1) or (n,).
        x0: optional noise (or other source) points (m, 2), drawn small and dark.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit; fitted to the data by default.
        size: marker area in points squared.
        condition_label: words beside the colour bar of a continuous condition.
        legend: name the classes (discrete c) or draw a colour bar (continuous c).

    Raises:
        ValueError: a shape does not fit.
    """
    points = as_points(x, "x")
    values, n_classes = as_classes(c, len(points))
    source = None if x0 is None else as_points(x0, "x0")
    ax = open_plane(ax, legend=legend)
    if source is not None:
        look: dict[str, Any] = {"color": SOURCE_COLOR, "alpha": 0.45, "linewidths": 0}
        ax.scatter(source[:, 0], source[:, 1], s=size * 0.6, label="noise", **look)
    dots: dict[str, Any] = {"s": size, "alpha": 0.75, "linewidths": 0}
    across, up = points.T
    if values is None:
        ax.scatter(across, up, color=COLORS["independent"], **dots)
    elif n_classes:
        for k in range(n_classes):
            rows = values == k
            look = {"color": condition_color(k), "marker": condition_marker(k), "label": f"c = {k}"}
            ax.scatter(across[rows], up[rows], **look, **dots)
    else:
        drawn = ax.scatter(across, up, c=values, cmap=CONDITION_MAP, **dots)
        if legend:
            ax.figure.colorbar(drawn, ax=ax, label=condition_label, shrink=0.85)
    if legend and n_classes:
        legend_beside(ax)
    return finish_plane(ax, title, limit)
