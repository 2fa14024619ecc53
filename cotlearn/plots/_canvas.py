"""Open a figure, and finish it: panels, axis words, titles and legends."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

from cotlearn.plots.style import COLORS

PANEL_SIZE = 2.9
PLANE = (PANEL_SIZE + 0.4, PANEL_SIZE + 0.3)
PLANE_WITH_LEGEND = (PANEL_SIZE + 1.3, PANEL_SIZE + 0.3)
CHART = (5.2, 3.4)


def panels(
    n: int, *, columns: int | None = None, size: float = PANEL_SIZE, shared: bool = False
) -> tuple[Figure, NDArray[Any]]:
    """Open a figure with ``n`` equal square panels.

    Args:
        n: number of panels, at least 1.
        columns: panels in a row; all of them by default.
        size: side of a panel in inches.
        shared: whether all panels have the same axis limits.

    Returns:
        The figure and a flat array of ``n`` Axes.

    Raises:
        ValueError: ``n`` or ``columns`` is below 1.
    """
    columns = n if columns is None else columns
    if n < 1 or columns < 1:
        raise ValueError(f"n and columns must be at least 1, got n={n}, columns={columns}")
    rows = -(-n // columns)
    figure, grid = plt.subplots(
        rows,
        columns,
        figsize=(size * columns, (size + 0.15) * rows),
        squeeze=False,
        sharex=shared,
        sharey=shared,
        layout="constrained",
    )
    for extra in grid.flat[n:]:
        extra.remove()
    return figure, grid.ravel()[:n]


def open_axes(ax: Axes | None, figsize: tuple[float, float]) -> Axes:
    """The Axes that were given, or those of a new figure of this size in inches."""
    if ax is not None:
        return ax
    _, fresh = plt.subplots(figsize=figsize, layout="constrained")
    return fresh


def open_plane(ax: Axes | None, *, legend: bool = False) -> Axes:
    """The Axes that were given, or a new square panel, with room beside it for a legend."""
    return open_axes(ax, PLANE_WITH_LEGEND if legend else PLANE)


def finish_plane(ax: Axes, title: str | None, limit: float | None) -> Axes:
    """Name the coordinates, and make both axes equal: from -limit to limit, or fitted."""
    finish(ax, xlabel="first coordinate", ylabel="second coordinate", title=title)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    if len(ax.get_shared_y_axes().get_siblings(ax)) > 1:
        ax.label_outer()
    ax.set_aspect("equal", adjustable="datalim" if limit is None else "box")
    if limit is not None:
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
    return ax


def finish(
    ax: Axes,
    *,
    xlabel: str,
    ylabel: str | None = None,
    title: str | None = None,
    legend: bool = False,
) -> Axes:
    """Write the words on the axes, and a title and a legend where they are wanted."""
    ax.set_xlabel(xlabel)
    if ylabel is not None:
        ax.set_ylabel(ylabel)
    if title is not None:
        ax.set_title(title)
    if legend:
        ax.legend()
    return ax


def legend_beside(ax: Axes) -> None:
    """A legend of classes to the right of a plane."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handletextpad=0.2, markerscale=1.8)


def plain_logarithms(axis: Axis) -> None:
    """Write 0.5 and 20 on a logarithmic axis instead of powers of ten, where they are short."""
    low, high = sorted(axis.get_view_interval())
    if high < 40 * low:  # one or two powers of ten: name steps between
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    if low >= 1e-3 and high < 2e4:
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())


def floor_line(ax: Axes, at: float, label: str, *, vertical: bool = False) -> None:
    """A dotted black line at the smallest value that can be expected."""
    draw = ax.axvline if vertical else ax.axhline
    draw(at, color=COLORS["truth"], linestyle=":", linewidth=1.3, label=label)
