"""Points of the plane: samples, the pairs of a coupling, and the paths of a flow."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.patches import Circle
from numpy.typing import NDArray

from cotlearn.plots import style
from cotlearn.plots._canvas import (
    Numbers,
    as_array,
    finish_plane,
    legend_beside,
    open_plane,
    panels,
    read_condition,
)

_CLASSES = {"handletextpad": 0.2, "markerscale": 1.8}  #: the legend of classes
_NOISE_LIMIT = 3.6


def scatter(
    x: Numbers,
    c: Numbers = None,
    *,
    x0: Numbers = None,
    ax: Axes | None = None,
    title: str = "",
    limit: float | None = None,
    size: float = 7.0,
    legend: bool = False,
) -> Axes:
    """Scatter points coloured by their condition, with the noise in dark behind them.

    Args:
        x: (n, 2) points.
        c: None, one-hot (n, K), classes (n,), or continuous (n, 1) or (n,).
        x0: optional noise (or other source) points (m, 2), drawn small and dark.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
        limit: both axes run from -limit to limit; fitted to the data by default.
        size: marker area in points squared.
        legend: name the classes (discrete c) or draw a colour bar (continuous c).
    """
    points = as_array(x, "n", 2)
    values, n_classes = read_condition(c, len(points))
    ax = open_plane(ax, legend=legend)
    if x0 is not None:
        across, up = as_array(x0, "m", 2).T
        ax.scatter(
            across, up, s=size * 0.6, color=style.SOURCE_COLOR, alpha=0.45, lw=0, label="noise"
        )
    across, up = points.T
    dots: dict[str, Any] = {"s": size, "alpha": 0.75, "linewidths": 0}
    if values is None:
        ax.scatter(across, up, color=style.COLORS["independent"], **dots)
    elif not n_classes:
        drawn = ax.scatter(across, up, c=values, cmap=style.CONDITION_MAP, **dots)
        if legend:
            ax.figure.colorbar(drawn, ax=ax, label="condition $c$", shrink=0.85)
    for k in range(n_classes):
        marker = style.CONDITION_MARKERS[k % len(style.CONDITION_MARKERS)]
        dots |= {"color": style.condition_color(k), "marker": marker, "label": f"c = {k}"}
        ax.scatter(*points[values == k].T, **dots)
    if legend and n_classes:
        legend_beside(ax, **_CLASSES)
    return finish_plane(ax, title, limit)


def over_data(
    x: Numbers, data: Numbers, *, coupling: str, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Draw samples of one method over data; the panel shows where the data are, and a margin.

    Args:
        x: (n, 2) samples, in the method's colour.
        data: (m, 2), larger and in grey behind them.
        coupling: name of the method, as in `LOOKS`.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
    """
    points, behind = as_array(x, "n", 2), as_array(data, "m", 2)
    ax = open_plane(ax)
    color = style.style_of(coupling)["color"]
    ax.scatter(behind[:, 0], behind[:, 1], s=14, color="#c4c4c4", lw=0)
    ax.scatter(points[:, 0], points[:, 1], s=7, color=color, alpha=0.7, lw=0)
    low, high = behind.min(axis=0), behind.max(axis=0)
    margin = 0.15 * (high - low) + 1e-3
    (left, down), (right, up) = low - margin, high + margin
    ax.set(xlim=(left, right), ylim=(down, up))
    ax.set_title(title, fontsize="small")
    ax.locator_params(nbins=4)
    return ax


def pair_lines(
    x0: Numbers, x1: Numbers, c: Numbers = None, *, size: float = 14.0, **options: Any
) -> Axes:
    """Draw a coupling: a line from each source point to the data point it was paired with.

    Args:
        x0: (n, 2) source points.
        x1: (n, 2) data points, row by row the partners of ``x0``.
        c: conditions of the data, as in :func:`scatter`; the lines take their colours.
        size: marker area in points squared.
        options: more of :func:`scatter`: ax, title, limit, legend.
    """
    start, end = as_array(x0, "n", 2), as_array(x1, "n", 2)
    colors = style.condition_colors(c, len(end), plain=style.PATH_COLOR)
    ax = scatter(end, c, x0=start, size=size, **options)
    lines = list(np.stack([start, end], axis=1))
    ax.add_collection(LineCollection(lines, colors=colors, lw=0.7, alpha=0.5, zorder=0))
    return ax


def trajectories(path: Numbers, c: Numbers = None, *, size: float = 9.0, **options: Any) -> Axes:
    """Draw the path of each sample, faint, from noise (dark) to its end (coloured by c).

    Args:
        path: (times, n, 2), as ``integrate(..., trajectory=True).trajectory``.
        c: as in :func:`scatter`, one row a sample.
        size: marker area in points squared.
        options: more of :func:`scatter`: ax, title, limit, legend.
    """
    points = as_array(path, "times", "n", 2)
    ax = scatter(points[-1], c, x0=points[0], size=size, **options)
    lines = list(points.swapaxes(0, 1))
    ax.add_collection(LineCollection(lines, colors=style.PATH_COLOR, lw=0.6, alpha=0.35, zorder=0))
    ax.autoscale_view()
    return ax


def paired_source(
    x0: Numbers, c: Numbers, *, ax: Axes | None = None, title: str = "", legend: bool = False
) -> Axes:
    """Show skew: source points coloured by the condition they were paired with.

    Without skew the colours are mixed everywhere; with skew each condition owns a region of the
    noise.

    Args:
        x0: (n, 2) source points.
        c: the condition each of them was paired with, as in :func:`scatter`.
        ax: Axes to draw into; a new figure by default.
        title: title of the panel.
        legend: as in :func:`scatter`.
    """
    points = as_array(x0, "n", 2)
    n_classes = read_condition(c, len(points))[1]
    if not n_classes:
        return scatter(points, c, ax=ax, title=title, limit=_NOISE_LIMIT, legend=legend)
    ax = open_plane(ax, legend=legend)
    order = np.random.default_rng(0).permutation(len(points))  # no class on top of another
    colors = style.condition_colors(c, len(points))[order]
    across, up = points[order].T
    ax.scatter(across, up, c=colors, s=7, alpha=0.75, linewidths=0)
    if legend:
        for k in range(n_classes):
            ax.scatter([], [], color=style.condition_color(k), s=7, label=f"c = {k}")
        legend_beside(ax, **_CLASSES)
    return finish_plane(ax, title, _NOISE_LIMIT)


def source_given_condition(
    x0: Numbers, c: Numbers, *, labels: Sequence[str] | None = None, title: str = ""
) -> NDArray[Any]:
    """Draw p(x0 | c), one panel per class: noise of the class in colour, other noise faint.

    The thin circle has radius 2: a standard normal in the plane keeps 86 % of its samples inside.

    Args:
        x0: (n, 2) source points.
        c: classes, one-hot (n, K) or integers (n,), that they were paired with.
        labels: labels of the classes.
        title: words in front of the first panel's title.

    Returns:
        The array of Axes.

    Raises:
        ValueError: c is continuous.
    """
    points = as_array(x0, "n", 2)
    values, n_classes = read_condition(c, len(points))
    if not n_classes:
        raise ValueError("c must be discrete: one-hot or integers; cut values into bins")
    labels = labels or [f"c = {k}" for k in range(n_classes)]
    _, axes = panels(n_classes, size=2.3, shared=True)
    for k, (ax, words) in enumerate(zip(axes, labels, strict=True)):
        rows = values == k
        ax.scatter(*points[~rows].T, color="#d0d0d0", s=3.5, linewidths=0, alpha=0.6)
        ax.scatter(*points[rows].T, color=style.condition_color(k), s=7, linewidths=0, alpha=0.85)
        ax.add_patch(Circle((0, 0), 2.0, fill=False, color=style.SOURCE_COLOR, lw=0.8, alpha=0.7))
        finish_plane(ax, f"{title}: {words}" if title and k == 0 else words, _NOISE_LIMIT)
    return axes
