"""The frontier: couplings between skew and one-step variance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cotlearn.plots._arrays import refuse_unknown
from cotlearn.plots._canvas import finish, open_axes
from cotlearn.plots._placement import place_labels
from cotlearn.plots.style import COLORS, PATH_COLOR, style_of


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
        refuse_unknown(given, what, names)
    x = np.array([_interval_of(point, "skew") for point in shown])
    y = np.array([_interval_of(point, "one_step_variance") for point in shown])
    if log and (y <= 0).any():
        raise ValueError("one_step_variance must be positive on a logarithmic axis")
    ax = open_axes(ax, (6.4, 4.2))
    joined = [names.index(name) for name in curve]
    ax.plot(x[joined, 1], y[joined, 1], color=COLORS["conditional_ot"], lw=1.0, alpha=0.5, zorder=1)
    for point, (left, at, right), (low, height, high) in zip(shown, x, y, strict=True):
        ax.errorbar(
            at,
            height,
            xerr=[[at - left], [right - at]],
            yerr=[[height - low], [high - height]],
            elinewidth=1.1,
            zorder=3,
            **{**style_of(point.coupling), "linestyle": "none"},
        )
    if log:
        ax.set_yscale("log")
    elif ax.get_autoscaley_on():
        ax.set_ylim(bottom=0)
    ax.axvline(0, color=PATH_COLOR, linewidth=0.8, zorder=0)
    ax.margins(x=0.12, y=0.08)
    ax.grid(True)
    words = "skew of the noise (0: none)"
    finish(ax, xlabel=words, ylabel="one-step variance", title=title)
    texts = [(labels or {}).get(name, name) for name in names]
    for k, name in enumerate(names):
        if errors is not None and name in errors:
            texts[k] += f"\nerror {errors[name]:.2g}"
    place_labels(ax, x, y, texts, [style_of(point.coupling)["color"] for point in shown])
    return ax


def _interval_of(point: Any, name: str) -> tuple[float, float, float]:
    """Low end, value and high end of a point's attribute; the value lies between the ends."""
    value = float(getattr(point, name))
    low, high = (float(end) for end in getattr(point, f"{name}_interval"))
    if not np.isfinite([low, value, high]).all():
        raise ValueError(f"{name} of {point.name!r} must be finite, got {value} ({low}, {high})")
    return min(low, value), value, max(high, value)
