"""Open a figure, and finish it: panels, axes, legends."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter
from numpy.typing import NDArray

PANEL_SIZE = 2.9
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
    """
    columns = columns or n
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


def open_axes(ax: Axes | None, figsize: tuple[float, float] = CHART) -> Axes:
    """The Axes that were given, or those of a new figure of this size in inches."""
    return ax or plt.subplots(figsize=figsize, layout="constrained")[1]


def open_plane(ax: Axes | None, *, legend: bool = False) -> Axes:
    """The Axes that were given, or a new square panel, with room beside it for a legend."""
    return open_axes(ax, (PANEL_SIZE + (1.3 if legend else 0.4), PANEL_SIZE + 0.3))


def finish_plane(ax: Axes, title: str, limit: float | None) -> Axes:
    """Name the coordinates, and make both axes equal: from -limit to limit, or fitted."""
    ax.set(xlabel="first coordinate", ylabel="second coordinate", title=title)
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    if len(ax.get_shared_y_axes().get_siblings(ax)) > 1:
        ax.label_outer()
    ax.set_aspect("equal", adjustable="datalim" if limit is None else "box")
    if limit is not None:
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
    return ax


def legend_beside(ax: Axes, **look: Any) -> None:
    """A legend to the right of the panel."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), **look)


def plain_logarithms(axis: Axis) -> None:
    """Write 0.5 and 20 on a logarithmic axis instead of powers of ten, where they are short."""
    low, high = sorted(axis.get_view_interval())
    if high < 40 * low:  # one or two powers of ten: name steps between
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    if low >= 1e-3 and high < 2e4:
        axis.set_major_formatter(lambda value, _: f"{value:g}")
        axis.set_minor_formatter(NullFormatter())
