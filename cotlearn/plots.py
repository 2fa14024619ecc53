"""Every figure of the course.

The functions here draw and compute nothing: what they are given is what is seen. They accept torch
tensors or numpy arrays, take ``ax=None`` (a new figure) and return the Axes, the array of Axes, or
the animation.

One look for the whole course: the source is dark, paths are faint, samples are coloured by their
condition, and a coupling keeps one colour, marker and line style in every figure, so that curves
can also be told apart in grey. Coupling colours are those of Okabe and Ito
(https://jfly.uni-koeln.de/color/), with two more from Paul Tol's palettes
(https://sronpersonalpages.nl/~pault/), as are the colours of conditions.
"""

from __future__ import annotations

import base64
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike, NDArray

COLORS: dict[str, str] = {
    "independent": "#0072B2",
    "minibatch_ot": "#D55E00",
    "conditional_ot": "#009E73",
    "adaptive": "#CC79A7",
    "stratified": "#56B4E9",
    "semidiscrete": "#E69F00",
    "aligned": "#882255",
    "reflow": "#999999",
    "truth": "#000000",
}
MARKERS: dict[str, str] = {
    "independent": "o",
    "minibatch_ot": "s",
    "conditional_ot": "^",
    "adaptive": "D",
    "stratified": "v",
    "semidiscrete": "P",
    "aligned": "X",
    "reflow": "*",
    "truth": ".",
}
LINESTYLES: dict[str, Any] = {
    "independent": "--",
    "minibatch_ot": "-.",
    "conditional_ot": "-",
    "adaptive": (0, (5, 1)),
    "stratified": (0, (3, 1, 1, 1)),
    "semidiscrete": (0, (1, 1)),
    "aligned": (0, (3, 1, 1, 1, 1, 1)),
    "reflow": (0, (5, 4)),
    "truth": ":",
}
LABELS: dict[str, str] = {
    "independent": "independent",
    "minibatch_ot": "minibatch OT (naive)",
    "conditional_ot": "conditional OT (COT)",
    "adaptive": "adaptive COT",
    "stratified": "stratified COT",
    "semidiscrete": "semidiscrete COT",
    "aligned": "model-aligned",
    "reflow": "reflow",
    "truth": "truth",
}
CONDITION_COLORS: tuple[str, ...] = (
    "#4477AA",
    "#EE6677",
    "#228833",
    "#CCBB44",
    "#66CCEE",
    "#AA3377",
    "#BBBBBB",
    "#DD7733",
    "#332288",
    "#117733",
)
CONDITION_MARKERS: tuple[str, ...] = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
CONDITION_MAP = "viridis"
SOURCE_COLOR = "#222222"
PATH_COLOR = "#8c8c8c"
PANEL_SIZE = 2.9

_PANEL = (PANEL_SIZE + 0.4, PANEL_SIZE + 0.3)
_PANEL_WITH_LEGEND = (PANEL_SIZE + 1.3, PANEL_SIZE + 0.3)
_STYLE_FILE = Path(__file__).with_name("course.mplstyle")


# ---------------------------------------------------------------- the canvas


def use_style() -> None:
    """Apply the course's style file to every figure made from now on."""
    plt.style.use(_STYLE_FILE)


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


def _axes(ax: Axes | None, *, figsize: tuple[float, float] | None = None) -> Axes:
    if ax is not None:
        return ax
    _, fresh = plt.subplots(figsize=figsize, layout="constrained")
    return fresh


def _array(value: ArrayLike | Any, name: str) -> NDArray[np.float64]:
    """A float array from a tensor (any device) or anything numpy understands."""
    if value is None:
        raise ValueError(f"{name} is None, expected a tensor or an array")
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is not an array of numbers: {error}") from None


def _points(value: ArrayLike | Any, name: str, *, rows: int | None = None) -> NDArray[np.float64]:
    array = _array(value, name)
    if array.ndim != 2 or array.shape[1] != 2:
        raise ValueError(f"{name} has shape {array.shape}, expected (n, 2)")
    if rows is not None and len(array) != rows:
        raise ValueError(f"{name} has {len(array)} rows, expected {rows}")
    return array


def _path(value: ArrayLike | Any, name: str) -> NDArray[np.float64]:
    array = _array(value, name)
    if array.ndim != 3 or array.shape[2] != 2 or array.shape[0] < 2:
        raise ValueError(f"{name} has shape {array.shape}, expected (times >= 2, n, 2)")
    return array


def _classes(c: ArrayLike | Any, rows: int) -> tuple[NDArray[Any] | None, int]:
    """Read a condition: (class of each row, number of classes), (value of each row, 0), (None, 0).

    One-hot rows (n, K >= 2) and integer vectors (n,) are classes; (n, 1) and float vectors (n,)
    are values.
    """
    if c is None:
        return None, 0
    array = _array(c, "c")
    if array.ndim not in (1, 2) or len(array) != rows:
        raise ValueError(f"c has shape {array.shape}, expected ({rows},) or ({rows}, k)")
    if array.ndim == 2 and array.shape[1] > 1:
        one_hot = np.isin(array, (0.0, 1.0)).all() and (array.sum(1) == 1).all()
        if not one_hot:
            raise ValueError(f"c has shape {array.shape} but is not one-hot; pass one value a row")
        return array.argmax(1), array.shape[1]
    values = array.reshape(rows)
    raw = c.detach().cpu().numpy() if hasattr(c, "detach") else np.asarray(c)
    if raw.ndim == 1 and np.issubdtype(raw.dtype, np.integer):
        if rows and values.min() < 0:
            raise ValueError("c has negative classes, expected integers from 0")
        return values.astype(int), int(values.max(initial=0)) + 1
    return values, 0


def _condition_color(k: int) -> str:
    return CONDITION_COLORS[k % len(CONDITION_COLORS)]


def _square(ax: Axes, limit: float | None) -> None:
    ax.set_aspect("equal", adjustable="datalim" if limit is None else "box")
    if limit is not None:
        ax.set_xlim(-limit, limit)
        ax.set_ylim(-limit, limit)


def _plane(ax: Axes, title: str | None, limit: float | None) -> Axes:
    ax.set_xlabel("first coordinate")
    ax.set_ylabel("second coordinate")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
    if len(ax.get_shared_y_axes().get_siblings(ax)) > 1:
        ax.label_outer()
    if title is not None:
        ax.set_title(title)
    _square(ax, limit)
    return ax


def style_of(name: str) -> dict[str, Any]:
    """Colour, marker and line style of a coupling, as keyword arguments for ``Axes.plot``.

    An unknown name gets a dark grey solid line, so that a reader's own coupling can be drawn too.
    """
    return {
        "color": COLORS.get(name, "#444444"),
        "marker": MARKERS.get(name, "h"),
        "linestyle": LINESTYLES.get(name, "-"),
    }


def label_of(name: str) -> str:
    """The words for a coupling in a legend; an unknown name stands for itself."""
    return LABELS.get(name, name)


# ---------------------------------------------------------------- points in the plane


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
    """Scatter points coloured by their condition, with the source in dark behind them.

    Args:
        x: (n, 2) points.
        c: None, one-hot (n, K), classes (n,), or continuous (n, 1) or (n,).
        x0: optional source points (m, 2), drawn small and dark.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        limit: both axes run from -limit to limit; fitted to the data by default.
        size: marker area in points squared.
        condition_label: words beside the colour bar of a continuous condition.
        legend: name the classes (discrete c) or draw a colour bar (continuous c).

    Raises:
        ValueError: a shape does not fit.
    """
    points = _points(x, "x")
    values, n_classes = _classes(c, len(points))
    source = None if x0 is None else _points(x0, "x0")
    ax = _axes(ax, figsize=_PANEL_WITH_LEGEND if legend else _PANEL)
    if source is not None:
        look: dict[str, Any] = {"color": SOURCE_COLOR, "alpha": 0.45, "linewidths": 0}
        ax.scatter(source[:, 0], source[:, 1], s=size * 0.6, label="source", **look)
    dots: dict[str, Any] = {"s": size, "alpha": 0.75, "linewidths": 0}
    if values is None:
        ax.scatter(points[:, 0], points[:, 1], color=COLORS["independent"], **dots)
    elif n_classes:
        for k in range(n_classes):
            rows = values == k
            ax.scatter(
                points[rows, 0],
                points[rows, 1],
                color=_condition_color(k),
                marker=CONDITION_MARKERS[k % len(CONDITION_MARKERS)],
                label=f"c = {k}",
                **dots,
            )
    else:
        drawn = ax.scatter(points[:, 0], points[:, 1], c=values, cmap=CONDITION_MAP, **dots)
        if legend:
            ax.figure.colorbar(drawn, ax=ax, label=condition_label, shrink=0.85)
    if legend and n_classes:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handletextpad=0.2, markerscale=1.8)
    return _plane(ax, title, limit)


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
    array = _path(path, "path")
    _classes(c, array.shape[1])
    ax = _axes(ax, figsize=_PANEL_WITH_LEGEND if legend else _PANEL)
    lines = LineCollection(
        list(array.transpose(1, 0, 2)), colors=PATH_COLOR, linewidths=0.6, alpha=0.35, zorder=0
    )
    ax.add_collection(lines)
    return scatter(
        array[-1], c, x0=array[0], ax=ax, title=title, limit=limit, size=size, legend=legend
    )


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
    start = _points(x0, "x0")
    end = _points(x1, "x1", rows=len(start))
    values, n_classes = _classes(c, len(start))
    ax = _axes(ax, figsize=_PANEL_WITH_LEGEND if legend else _PANEL)
    segments = LineCollection(
        list(np.stack([start, end], axis=1)), linewidths=0.7, alpha=0.5, zorder=0
    )
    if values is None:
        segments.set_color(PATH_COLOR)
    elif n_classes:
        segments.set_color([_condition_color(int(k)) for k in values])
    else:
        segments.set_array(values)
        segments.set_cmap(CONDITION_MAP)
    ax.add_collection(segments)
    return scatter(end, c, x0=start, ax=ax, title=title, limit=limit, size=size, legend=legend)


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
    places = _points(points, "points")
    arrows = _points(velocity, "velocity", rows=len(places))
    ax = _axes(ax, figsize=_PANEL)
    ax.quiver(*places.T, *arrows.T, color=color, width=0.0045, alpha=0.85, pivot="mid")
    return _plane(ax, title, limit)


# ---------------------------------------------------------------- skew


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
    points = _points(x0, "x0")
    order = np.random.default_rng(0).permutation(len(points))  # no class on top of another
    values, n_classes = _classes(c, len(points))
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
    ax = _axes(ax, figsize=_PANEL_WITH_LEGEND if legend else _PANEL)
    if legend:
        for k in range(n_classes):
            ax.scatter([], [], color=_condition_color(k), s=size, label=f"c = {k}")
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handletextpad=0.2, markerscale=1.8)
    colors = [_condition_color(int(k)) for k in values[order]]
    ax.scatter(points[order, 0], points[order, 1], c=colors, s=size, alpha=0.75, linewidths=0)
    return _plane(ax, title, limit)


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
    points = _points(x0, "x0")
    values, n_classes = _classes(c, len(points))
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
        ax.scatter(
            points[~rows, 0],
            points[~rows, 1],
            color="#d0d0d0",
            s=size * 0.5,
            linewidths=0,
            alpha=0.6,
        )
        ax.scatter(
            points[rows, 0],
            points[rows, 1],
            color=_condition_color(k),
            s=size,
            linewidths=0,
            alpha=0.85,
        )
        ax.add_patch(Circle((0, 0), 2.0, fill=False, color=SOURCE_COLOR, lw=0.8, alpha=0.7))
        words = f"c = {k}" if labels is None else labels[k]
        _plane(ax, f"{title}: {words}" if title and k == 0 else words, limit)
    return grid


# ---------------------------------------------------------------- numbers


def error_against_nfe(
    nfe: ArrayLike | Any,
    errors: Mapping[str, ArrayLike | Any],
    *,
    floor: float | None = None,
    floor_label: str = "floor: truth against truth",
    ax: Axes | None = None,
    title: str | None = None,
    ylabel: str = "squared conditional $W_2$",
    labels: Mapping[str, str] | None = None,
    log: bool = True,
    legend: bool = True,
) -> Axes:
    """Plot error against the number of network evaluations, both on logarithmic axes.

    Args:
        nfe: (m,) numbers of evaluations, at least 1 each.
        errors: name of the coupling -> (m,) one seed, or (seeds, m); the line is the mean over
            seeds, the band reaches from the best seed to the worst.
        floor: a dotted line at the smallest error that this many samples can show.
        floor_label: its words.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        ylabel: words beside the vertical axis.
        labels: words for the legend where they differ from ``LABELS``.
        log: whether the error's axis is logarithmic; errors must then be positive.
        legend: whether to draw the legend.

    Raises:
        ValueError: a shape does not fit, or an error is not finite or not positive.
    """
    steps = _array(nfe, "nfe")
    if steps.ndim != 1 or len(steps) < 1 or steps.min() < 1:
        raise ValueError(f"nfe has shape {steps.shape}, expected (m,) with values of at least 1")
    curves = {name: np.atleast_2d(_array(v, f"errors[{name!r}]")) for name, v in errors.items()}
    for name, curve in curves.items():
        if curve.ndim != 2 or curve.shape[1] != len(steps):
            raise ValueError(
                f"errors[{name!r}] has shape {curve.shape}, "
                f"expected ({len(steps)},) or (seeds, {len(steps)})"
            )
        if not np.isfinite(curve).all() or (log and (curve <= 0).any()):
            raise ValueError(f"errors[{name!r}] must be finite, and positive on a logarithmic axis")
    ax = _axes(ax, figsize=(5.2, 3.4))
    for name, curve in curves.items():
        label = (labels or {}).get(name, label_of(name))
        if len(curve) > 1:
            ax.fill_between(
                steps, curve.min(0), curve.max(0), color=style_of(name)["color"], alpha=0.18, lw=0
            )
        ax.plot(steps, curve.mean(0), label=label, **style_of(name))
    if floor is not None:
        ax.axhline(floor, color=COLORS["truth"], linestyle=":", linewidth=1.3, label=floor_label)
    ax.set_xscale("log", base=2)
    if log:
        ax.set_yscale("log")
    ax.set_xticks(steps, [f"{s:g}" for s in steps])
    ax.minorticks_off()
    ax.grid(True)
    ax.set_xlabel("network evaluations per sample (NFE)")
    ax.set_ylabel(ylabel)
    if title is not None:
        ax.set_title(title)
    if legend:
        ax.legend()
    return ax


def curves(
    x: ArrayLike | Any,
    values: Mapping[str, ArrayLike | Any],
    *,
    ax: Axes | None = None,
    xlabel: str,
    ylabel: str,
    title: str | None = None,
    labels: Mapping[str, str] | None = None,
    log: str = "",
    legend: bool = True,
) -> Axes:
    """Plot named curves over one horizontal axis, in the colours of their couplings.

    Args:
        x: (m,) positions.
        values: name -> (m,) values.
        ax: where to draw; a new figure by default.
        xlabel: words below.
        ylabel: words beside.
        title: words above.
        labels: words for the legend where they differ from ``LABELS``.
        log: "", "x", "y" or "xy": the axes that are logarithmic.
        legend: whether to draw the legend.

    Raises:
        ValueError: a shape does not fit, or ``log`` is unknown.
    """
    if log not in ("", "x", "y", "xy"):
        raise ValueError(f"log is {log!r}, expected '', 'x', 'y' or 'xy'")
    position = _array(x, "x")
    lines = {name: _array(v, f"values[{name!r}]") for name, v in values.items()}
    for name, line in lines.items():
        if position.ndim != 1 or line.shape != position.shape:
            raise ValueError(
                f"values[{name!r}] has shape {line.shape}, expected that of x, {position.shape}"
            )
    ax = _axes(ax, figsize=(5.2, 3.4))
    for name, line in lines.items():
        ax.plot(position, line, label=(labels or {}).get(name, label_of(name)), **style_of(name))
    if "x" in log:
        ax.set_xscale("log")
    if "y" in log:
        ax.set_yscale("log")
    ax.grid(True)
    ax.set_xlabel(xlabel)
    ax.set_ylabel(ylabel)
    if title is not None:
        ax.set_title(title)
    if legend:
        ax.legend()
    return ax


def training_curves(
    histories: Mapping[str, Mapping[str, ArrayLike | Any]],
    *,
    ax: Axes | None = None,
    title: str | None = None,
    ylabel: str = "flow-matching loss",
) -> Axes:
    """Plot the loss of each training against its step: every value faint, a running mean strong.

    Args:
        histories: name -> a history with "step" and "loss", as ``fit(...).history``.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        ylabel: words beside the vertical axis.

    Raises:
        ValueError: a history lacks "step" or "loss", or they differ in length.
    """
    lines = {}
    for name, history in histories.items():
        if "step" not in history or "loss" not in history:
            raise ValueError(f"histories[{name!r}] has {sorted(history)}, expected step and loss")
        step, loss = _array(history["step"], "step"), _array(history["loss"], "loss")
        if step.ndim != 1 or step.shape != loss.shape:
            raise ValueError(
                f"histories[{name!r}]: step has shape {step.shape}, loss {loss.shape}; "
                "expected two vectors of one length"
            )
        lines[name] = (step, loss)
    ax = _axes(ax, figsize=(5.2, 3.4))
    for name, (step, loss) in lines.items():
        look = {**style_of(name), "marker": None}
        ax.plot(step, loss, color=look["color"], linewidth=0.7, alpha=0.3)
        window = max(1, len(loss) // 40)
        mean = np.convolve(loss, np.ones(window) / window, mode="valid")
        ax.plot(step[window - 1 :], mean, label=label_of(name), **look)
    ax.set_xlabel("training step")
    ax.set_ylabel(ylabel)
    ax.set_ylim(bottom=0)
    ax.grid(True, axis="y")
    if title is not None:
        ax.set_title(title)
    ax.legend()
    return ax


def bars(
    values: Mapping[str, float],
    *,
    intervals: Mapping[str, tuple[float, float]] | None = None,
    floor: float | None = None,
    floor_label: str = "floor",
    ax: Axes | None = None,
    ylabel: str,
    title: str | None = None,
    labels: Mapping[str, str] | None = None,
    log: bool = False,
) -> Axes:
    """Draw a horizontal bar for each name, its value at the end, with intervals and a floor.

    Args:
        values: name -> height.
        intervals: name -> (low, high).
        floor: a dotted line.
        floor_label: its words.
        ax: where to draw; a new figure by default.
        ylabel: words for the quantity, below the axis.
        title: words above.
        labels: words for the names where they differ from ``LABELS``.
        log: logarithmic axis.

    Raises:
        ValueError: no values, a value that is not finite, or an interval for an unknown name.
    """
    if not values or not all(np.isfinite(v) for v in values.values()):
        raise ValueError(f"values must be finite and not empty, got {dict(values)}")
    intervals = intervals or {}
    unknown = set(intervals) - set(values)
    if unknown:
        raise ValueError(f"intervals has names without a value: {sorted(unknown)}")
    ax = _axes(ax, figsize=(5.2, 0.9 + 0.42 * len(values)))
    for row, (name, value) in enumerate(values.items()):
        ax.barh(row, value, color=style_of(name)["color"], height=0.62)
        low, high = intervals.get(name, (value, value))
        if name in intervals:
            ax.plot([low, high], [row, row], color="#222222", linewidth=1.4, solid_capstyle="butt")
        ax.annotate(
            f"{value:.3g}", (max(value, high), row), (4, 0), textcoords="offset points", va="center"
        )
    if floor is not None:
        ax.axvline(floor, color=COLORS["truth"], linestyle=":", linewidth=1.3, label=floor_label)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    if log:
        ax.set_xscale("log")
    ax.margins(x=0.14)
    ax.set_yticks(range(len(values)), [(labels or {}).get(name, label_of(name)) for name in values])
    ax.invert_yaxis()
    ax.set_xlabel(ylabel)
    if title is not None:
        ax.set_title(title)
    return ax


def histogram(
    values: Mapping[str, ArrayLike | Any],
    *,
    bins: int = 40,
    ax: Axes | None = None,
    xlabel: str,
    title: str | None = None,
) -> Axes:
    """Draw outlined histograms of several samples over common bins, as densities.

    Args:
        values: name -> (n,) numbers.
        bins: number of common bins.
        ax: where to draw; a new figure by default.
        xlabel: words below.
        title: words above.

    Raises:
        ValueError: a sample is not a non-empty vector of finite numbers.
    """
    samples = {name: _array(v, f"values[{name!r}]") for name, v in values.items()}
    for name, sample in samples.items():
        if sample.ndim != 1 or sample.size == 0 or not np.isfinite(sample).all():
            raise ValueError(f"values[{name!r}] has shape {sample.shape}, expected finite (n,)")
    if not samples:
        raise ValueError("values is empty, expected at least one sample")
    everything = np.concatenate(list(samples.values()))
    edges = np.linspace(everything.min(), everything.max() + 1e-9, bins + 1)
    ax = _axes(ax, figsize=(5.2, 3.0))
    for name, sample in samples.items():
        look = {key: style_of(name)[key] for key in ("color", "linestyle")}
        ax.hist(
            sample,
            bins=list(edges),
            density=True,
            histtype="step",
            lw=1.6,
            label=label_of(name),
            **look,
        )
    ax.set_xlabel(xlabel)
    ax.set_ylabel("density")
    ax.margins(y=0.28)  # room for the legend
    if title is not None:
        ax.set_title(title)
    ax.legend()
    return ax


def image_grid(
    images: ArrayLike | Any,
    *,
    columns: int = 10,
    side: int = 8,
    ax: Axes | None = None,
    title: str | None = None,
    row_labels: Sequence[str] | None = None,
) -> Axes:
    """Tile small square images, row by row, dark ink on white.

    Args:
        images: (n, side * side) or (n, side, side) with values in [-1, 1], 1 being ink.
        columns: images in a row.
        side: pixels a side.
        ax: where to draw; a new figure by default.
        title: words above.
        row_labels: words beside the rows.

    Raises:
        ValueError: a shape does not fit.
    """
    array = _array(images, "images")
    if array.ndim == 2 and array.shape[1] == side * side:
        array = array.reshape(-1, side, side)
    if array.ndim != 3 or array.shape[1:] != (side, side) or len(array) < 1:
        raise ValueError(
            f"images has shape {array.shape}, expected (n, {side * side}) or (n, {side}, {side})"
        )
    if columns < 1:
        raise ValueError(f"columns is {columns}, expected at least 1")
    rows = -(-len(array) // columns)
    if row_labels is not None and len(row_labels) != rows:
        raise ValueError(f"row_labels has {len(row_labels)} entries, expected {rows}")
    cell = side + 1
    canvas = np.full((rows * cell - 1, columns * cell - 1), -1.0)
    for index, image in enumerate(array):
        top, left = (index // columns) * cell, (index % columns) * cell
        canvas[top : top + side, left : left + side] = image
    ax = _axes(ax, figsize=(0.52 * columns + 1.0, 0.52 * rows + 0.4))
    ax.imshow(canvas, cmap="gray_r", vmin=-1, vmax=1, interpolation="nearest")
    ax.set_xticks([])
    if row_labels is None:
        ax.set_yticks([])
    else:
        ax.set_yticks([r * cell + side / 2 - 0.5 for r in range(rows)], list(row_labels))
        ax.tick_params(axis="y", length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    if title is not None:
        ax.set_title(title)
    return ax


# ---------------------------------------------------------------- the frontier


def frontier(
    points: Iterable[Any],
    *,
    errors: Mapping[str, float] | None = None,
    labels: Mapping[str, str] | None = None,
    curve: Sequence[str] = (),
    ax: Axes | None = None,
    title: str | None = None,
    log: bool = False,
) -> Axes:
    """Draw couplings between skew (across) and one-step variance (up); the origin is best.

    Bars are the 95 % intervals. Names stand beside the points and do not cover each other.

    Args:
        points: a `diagnostics.Frontier`, or anything with the attributes of its points: name,
            coupling, skew, skew_interval, one_step_variance, one_step_variance_interval.
        errors: name -> a measured error that is written below the name.
        labels: words where they differ from the names.
        curve: names that a line joins in this order: a sweep of weights.
        ax: where to draw; a new figure by default. Its size and limits should be set before.
        title: words above the panel.
        log: whether the one-step variance has a logarithmic axis.

    Raises:
        ValueError: no points, values that are not finite, or unknown names in errors,
            labels or curve.
    """
    shown = list(points)
    names = [point.name for point in shown]
    if not shown:
        raise ValueError("points is empty, expected at least one coupling")
    for what, given in (("errors", errors), ("labels", labels), ("curve", curve)):
        unknown = sorted(set(given or ()) - set(names))
        if unknown:
            raise ValueError(f"{what} has {unknown}, which are not among the points {names}")
    x = np.array([_interval_of(point, "skew") for point in shown])
    y = np.array([_interval_of(point, "one_step_variance") for point in shown])
    if log and (y <= 0).any():
        raise ValueError("one_step_variance must be positive on a logarithmic axis")
    ax = _axes(ax, figsize=(6.4, 4.2))
    joined = [names.index(name) for name in curve]
    ax.plot(x[joined, 1], y[joined, 1], color=COLORS["conditional_ot"], lw=1.0, alpha=0.5, zorder=1)
    for point, (left, at, right), (low, height, high) in zip(shown, x, y, strict=True):
        ax.errorbar(
            at,
            height,
            xerr=[[at - left], [right - at]],
            yerr=[[height - low], [high - height]],
            color=style_of(point.coupling)["color"],
            marker=style_of(point.coupling)["marker"],
            linestyle="none",
            elinewidth=1.1,
            zorder=3,
        )
    if log:
        ax.set_yscale("log")
    elif ax.get_autoscaley_on():
        ax.set_ylim(bottom=0)
    ax.axvline(0, color=PATH_COLOR, linewidth=0.8, zorder=0)
    ax.margins(x=0.12, y=0.08)
    ax.grid(True)
    ax.set_xlabel("skew of the noise (0: none)")
    ax.set_ylabel("one-step variance")
    if title is not None:
        ax.set_title(title)
    texts = [(labels or {}).get(name, name) for name in names]
    for k, name in enumerate(names):
        if errors is not None and name in errors:
            texts[k] += f"\nerror {errors[name]:.2g}"
    _place_labels(ax, x, y, texts, [style_of(point.coupling)["color"] for point in shown])
    return ax


def _interval_of(point: Any, name: str) -> tuple[float, float, float]:
    """Low end, value and high end of a point's attribute; the value lies between the ends."""
    value = float(getattr(point, name))
    low, high = (float(end) for end in getattr(point, f"{name}_interval"))
    if not np.isfinite([low, value, high]).all():
        raise ValueError(f"{name} of {point.name!r} must be finite, got {value} ({low}, {high})")
    return min(low, value), value, max(high, value)


def _place_labels(
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
            texts[k], (x[k, 1], y[k, 1]), fontsize=8, color=colors[k], in_layout=False
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


# ---------------------------------------------------------------- motion


def animate(
    paths: Mapping[str, ArrayLike | Any],
    c: ArrayLike | Any = None,
    *,
    limit: float,
    titles: Mapping[str, str] | None = None,
    size: float = 6.0,
    panel: float = 2.5,
    hold: int = 6,
    interval: int = 110,
) -> FuncAnimation:
    """Animate samples of several methods side by side, all starting from the same noise.

    Show it with :func:`gif` (small, plays everywhere) or ``.to_jshtml()`` (with a slider).

    Args:
        paths: name -> (times, n, 2); the same number of times and samples for each.
        c: the condition of each sample, as in :func:`scatter`.
        limit: all axes run from -limit to limit.
        titles: words above the panels where they differ from ``LABELS``.
        size: marker area in points squared.
        panel: side of a panel in inches.
        hold: the last frame is shown this many times more.
        interval: milliseconds a frame.

    Raises:
        ValueError: no paths, or shapes that do not fit.
    """
    arrays = {name: _path(path, f"paths[{name!r}]") for name, path in paths.items()}
    if not arrays:
        raise ValueError("paths is empty, expected at least one (times, n, 2)")
    shapes = {array.shape for array in arrays.values()}
    if len(shapes) > 1:
        raise ValueError(f"paths have different shapes {sorted(shapes)}, expected one")
    times, n = next(iter(shapes))[:2]
    values, n_classes = _classes(c, n)
    if values is None:
        colors: Any = COLORS["independent"]
    elif n_classes:
        colors = [_condition_color(int(k)) for k in values]
    else:
        span = max(float(np.ptp(values)), 1e-12)
        colors = plt.get_cmap(CONDITION_MAP)((values - values.min()) / span)
    figure, axes = panels(len(arrays), size=panel, shared=True)
    dots = []
    for ax, (name, array) in zip(axes, arrays.items(), strict=True):
        dots.append(ax.scatter(*array[0].T, s=size, c=colors, alpha=0.8, linewidths=0))
        _plane(ax, (titles or {}).get(name, label_of(name)), limit)

    def draw(frame: int) -> list[Any]:
        index = min(frame, times - 1)
        for dot, array in zip(dots, arrays.values(), strict=True):
            dot.set_offsets(array[index])
        return dots

    animation = FuncAnimation(figure, draw, frames=times + hold, interval=interval, blit=False)
    plt.close(figure)  # the notebook shows the animation, not its first frame beside it
    return animation


@dataclass(frozen=True)
class Gif:
    """A GIF that notebooks display, and pages made from them too."""

    data: bytes

    def _repr_mimebundle_(self, **options: Any) -> dict[str, str]:
        encoded = base64.b64encode(self.data).decode()
        page = f'<img alt="animation" src="data:image/gif;base64,{encoded}">'
        return {"image/gif": encoded, "text/html": page, "text/plain": "<animation>"}


def gif(animation: FuncAnimation, *, fps: int = 9, dpi: int = 72) -> Gif:
    """Render an animation as a GIF for display in a notebook.

    Args:
        animation: from :func:`animate`.
        fps: frames a second.
        dpi: dots an inch; 72 keeps three panels of 30 frames well below 1 MB.

    Returns:
        What a cell displays; the bytes are in ``.data``.
    """
    return Gif(gif_bytes(animation, fps=fps, dpi=dpi))


def gif_bytes(animation: FuncAnimation, *, fps: int = 9, dpi: int = 72) -> bytes:
    """The bytes of an animation as a GIF, drawn by Pillow."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "animation.gif"
        animation.save(target, writer=PillowWriter(fps=fps), dpi=dpi)
        return target.read_bytes()
