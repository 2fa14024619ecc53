"""One number a method, or many: bars and histograms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_array, refuse_unknown
from cotlearn.plots._canvas import finish, floor_line, open_axes, plain_logarithms
from cotlearn.plots.style import label_of, style_of


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
    refuse_unknown(intervals, "intervals", values)
    ax = open_axes(ax, (5.2, 0.9 + 0.42 * len(values)))
    for row, (name, value) in enumerate(values.items()):
        ax.barh(row, value, color=style_of(name)["color"], height=0.62)
        low, high = intervals.get(name, (value, value))
        if name in intervals:
            ax.plot([low, high], [row, row], color="#222222", linewidth=1.4, solid_capstyle="butt")
        ax.annotate(
            f"{value:.3g}", (max(value, high), row), (4, 0), textcoords="offset points", va="center"
        )
    if floor is not None:
        floor_line(ax, floor, floor_label, vertical=True)
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    if log:
        ax.set_xscale("log")
    ax.margins(x=0.14)
    if log:
        plain_logarithms(ax.xaxis)
    ax.set_yticks(range(len(values)), [label_of(name, labels) for name in values])
    ax.invert_yaxis()
    return finish(ax, xlabel=ylabel, title=title)


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
    samples = {name: as_array(v, f"values[{name!r}]") for name, v in values.items()}
    for name, sample in samples.items():
        if sample.ndim != 1 or sample.size == 0 or not np.isfinite(sample).all():
            raise ValueError(f"values[{name!r}] has shape {sample.shape}, expected finite (n,)")
    if not samples:
        raise ValueError("values is empty, expected at least one sample")
    everything = np.concatenate(list(samples.values()))
    edges = np.linspace(everything.min(), everything.max() + 1e-9, bins + 1)
    ax = open_axes(ax, (5.2, 3.0))
    outline: dict[str, Any] = {"density": True, "histtype": "step", "lw": 1.6}
    for name, sample in samples.items():
        look = {key: style_of(name)[key] for key in ("color", "linestyle")}
        ax.hist(sample, bins=list(edges), label=label_of(name), **outline, **look)
    ax.margins(y=0.28)  # room for the legend
    return finish(ax, xlabel=xlabel, ylabel="density", title=title, legend=True)
