"""Charts with one row per name: bars, published results, differences, and a heat map."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cotlearn.plots._canvas import Numbers, as_array, legend_beside, logarithmic, open_axes
from cotlearn.plots.style import FLOOR, PATH_COLOR, SOURCE_COLOR, label_of, style_of


def bars(
    values: Mapping[str, float],
    *,
    ax: Axes | None = None,
    ylabel: str,
    title: str = "",
    labels: Mapping[str, str] | None = None,
    log: bool = False,
) -> Axes:
    """Draw a horizontal bar for each name, its value beside it.

    Args:
        values: name -> height.
        ax: Axes to draw into; a new figure by default.
        ylabel: words for the quantity, below the axis.
        title: title of the figure.
        labels: name -> label, if it differs from ``label_of``.
        log: logarithmic axis.
    """
    ax = open_axes(ax, (5.2, 0.9 + 0.42 * len(values)))
    colors = [style_of(name)["color"] for name in values]
    drawn = ax.barh(range(len(values)), list(values.values()), color=colors, height=0.62)
    ax.bar_label(drawn, fmt="{:.3g}", padding=4)
    ax.margins(x=0.14)
    logarithmic(ax, "x" if log else "")
    ax.set(xlabel=ylabel, title=title)
    return _name_rows(ax, [label_of(name, labels) for name in values])


def beside_published(
    ours: Mapping[str, Numbers],
    published: Mapping[str, float],
    *,
    floor: float | None = None,
    labels: Mapping[str, str] | None = None,
    ax: Axes | None = None,
    title: str = "",
    legend: bool = True,
) -> Axes:
    """Draw one row per method: the mean of our seeds, filled, and the published score, hollow.

    The line through the mean spans the best and the worst seed. The axis is logarithmic.

    Args:
        ours: name -> (seeds,) positive scores, drawn from top to bottom.
        published: name -> a positive score; names among those of ``ours``.
        floor: a dotted line at what true samples score with as many points as ours.
        labels: name -> label, if it differs from ``label_of``.
        ax: Axes to draw into; a new figure by default.
        title: title of the figure.
        legend: whether to say what filled, hollow and dotted mean.
    """
    ax = open_axes(ax, (5.2, 1.1 + 0.34 * len(ours)))
    hollow: dict[str, Any] = {"marker": "D", "markerfacecolor": "white", "linestyle": "none"}
    for row, (name, scores) in enumerate(ours.items()):
        values, look = as_array(scores), style_of(name)
        ax.plot([values.min(), values.max()], [row] * 2, color=look["color"], lw=1.6, alpha=0.6)
        ax.plot(values.mean(), row, **{**look, "linestyle": "none"})
        if name in published:
            ax.plot(published[name], row, color=look["color"], **hollow)
    if floor is not None:
        ax.axvline(floor, label="our floor", **FLOOR)
    if legend:
        ax.plot([], [], "o", color=SOURCE_COLOR, label="here, all seeds")
        ax.plot([], [], color=SOURCE_COLOR, label="published", **hollow)
        legend_beside(ax)
    logarithmic(ax, "x")
    ax.grid(True, axis="x")
    ax.set(xlabel="squared $W_2$", title=title)
    return _name_rows(ax, [label_of(name, labels) for name in ours])


def differences(
    rows: Mapping[str, tuple[float, float, float]],
    *,
    methods: Mapping[str, str],
    margin: float | None = None,
    ax: Axes | None = None,
    xlabel: str,
) -> Axes:
    """Draw one row per difference to a reference: value and interval, with a line at zero.

    Args:
        rows: label -> (mean, low, high), drawn from top to bottom.
        methods: label -> the method whose colour and marker the row has.
        margin: the largest acceptable loss, a dotted line at -margin.
        ax: Axes to draw into; a new figure by default.
        xlabel: label of the horizontal axis.
    """
    ax = open_axes(ax, (5.6, 1.0 + 0.24 * len(rows)))
    ax.axvline(0, color=PATH_COLOR, linewidth=0.9, zorder=0)
    if margin is not None:
        ax.axvline(-margin, color=SOURCE_COLOR, linestyle=":", linewidth=1.1, zorder=0)
    for row, (name, (mean, low, high)) in enumerate(rows.items()):
        look = style_of(methods[name])
        ax.plot([low, high], [row, row], color=look["color"], linewidth=1.6)
        ax.plot(mean, row, color=look["color"], marker=look["marker"])
    ax.grid(True, axis="x")
    ax.locator_params(axis="x", nbins=5)  # the words beside leave little room
    ax.set_xlabel(xlabel)
    return _name_rows(ax, list(rows))


def strata_heatmap(
    values: Numbers,
    *,
    rows: Sequence[Any],
    columns: Sequence[Any],
    limits: tuple[float | None, float | None] = (None, None),
    digits: int = 2,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Draw a table as coloured cells with their numbers: bright is large.

    Args:
        values: (rows, columns); NaN for cells that are not there.
        rows: numbers of episodes, from top to bottom.
        columns: numbers of strata.
        limits: the values that are darkest and brightest; the smallest and largest by default.
        digits: after the point.
        ax: Axes to draw into; a new figure by default.
        title: title of the figure.
    """
    table = as_array(values, len(rows), len(columns))
    ax = open_axes(ax, (1.2 + 0.75 * len(columns), 1.0 + 0.6 * len(rows)))
    image = ax.imshow(table, vmin=limits[0], vmax=limits[1], aspect="auto")
    for (i, j), value in np.ndenumerate(table):
        if np.isfinite(value):
            shade = SOURCE_COLOR if value > np.mean(image.get_clim()) else "white"
            ax.text(j, i, f"{value:.{digits}f}", ha="center", va="center", color=shade)
    ax.set_xticks(range(len(columns)), columns)
    ax.set_yticks(range(len(rows)), rows)
    ax.set(xlabel="strata", ylabel="episodes", title=title)
    return ax


def _name_rows(ax: Axes, names: Sequence[str]) -> Axes:
    """Write the names beside the rows 0, 1, ..., from top to bottom."""
    ax.set(yticks=range(len(names)), yticklabels=names, ylim=(len(names) - 0.5, -0.5))
    return ax
