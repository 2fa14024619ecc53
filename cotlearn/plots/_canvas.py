"""Helpers of all figures: arrays, panels, axes and legends."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from cotlearn.validation import check_real

Array = Any  #: NDArray[np.float64]; the stubs of matplotlib refuse arrays that it takes
Numbers = Any  #: a torch tensor on any device, or anything that numpy understands
PANEL_SIZE = 2.9
CHART = (5.2, 3.4)


def as_array(value: Numbers, *shape: int | str) -> Array:
    """A float array from a tensor (any device) or anything numpy understands.

    Args:
        value: numbers.
        shape: expected shape, say ``"n", 2``; a string allows any size. Any shape by default.

    Raises:
        ValueError: the array has another shape.
    """
    if hasattr(value, "detach"):
        value = value.detach().cpu()
    array = check_real(value, "value").astype(np.float64, copy=False)
    wanted = [got if isinstance(n, str) else n for n, got in zip(shape, array.shape, strict=False)]
    if shape and (len(shape) != array.ndim or tuple(wanted) != array.shape):
        expected = ", ".join(map(str, shape))
        raise ValueError(f"expected an array of shape ({expected}), got {array.shape}")
    return array


def read_condition(c: Numbers, rows: int) -> tuple[NDArray[Any] | None, int]:
    """Read a condition: (class of each row, number of classes), (value of each row, 0), (None, 0).

    One-hot rows (n, K >= 2) and integer vectors (n,) are classes; (n, 1) and float vectors (n,)
    are values.

    Raises:
        ValueError: c does not have one row per point, or has several columns but is not one-hot.
    """
    if c is None:
        return None, 0
    array = np.asarray(c.detach().cpu() if hasattr(c, "detach") else c)
    if len(array) != rows:
        raise ValueError(f"c has shape {array.shape}, expected one row for each of {rows} points")
    if array.ndim == 2 and array.shape[1] > 1:
        if not (np.isin(array, (0, 1)).all() and (array.sum(1) == 1).all()):
            raise ValueError(f"c has shape {array.shape} but is not one-hot; pass one value a row")
        return array.argmax(1), array.shape[1]
    if array.ndim == 1 and np.issubdtype(array.dtype, np.integer):
        return array, int(array.max(initial=0)) + 1
    return array.reshape(rows).astype(np.float64), 0


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
    """Return ``ax``, or the Axes of a new figure of this size in inches."""
    return ax or plt.subplots(figsize=figsize, layout="constrained")[1]


def open_plane(ax: Axes | None, *, legend: bool = False) -> Axes:
    """Return ``ax``, or a new square panel, with room for a legend beside it if asked for."""
    return open_axes(ax, (PANEL_SIZE + (1.3 if legend else 0.4), PANEL_SIZE + 0.3))


def finish_plane(ax: Axes, title: str, limit: float | None) -> Axes:
    """Name the coordinates, and make both axes equal: from -limit to limit, or fitted."""
    ax.set(xlabel="first coordinate", ylabel="second coordinate", title=title)
    ax.locator_params(nbins=4, steps=[1, 2, 5, 10])
    if len(ax.get_shared_y_axes().get_siblings(ax)) > 1:
        ax.label_outer()
    ax.set_aspect("equal", adjustable="datalim" if limit is None else "box")
    if limit is not None:
        ax.set(xlim=(-limit, limit), ylim=(-limit, limit))
    return ax


def legend_beside(ax: Axes, **look: Any) -> None:
    """A legend to the right of the panel."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), **look)


def logarithmic(ax: Axes, names: str) -> None:
    """Make axes, "x", "y" or "xy", logarithmic once all is drawn.

    Tick labels are written as 0.5 and 20 instead of powers of ten if that is short.
    """
    for name in names:
        axis = ax.xaxis if name == "x" else ax.yaxis
        ax.set(**{f"{name}scale": "log"})
        low, high = sorted(axis.get_view_interval())
        if high < 40 * low:  # one or two powers of ten: name steps between
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        if low >= 1e-3 and high < 2e4:
            axis.set_major_formatter(lambda value, _: f"{value:g}")
            axis.set_minor_formatter(NullFormatter())
