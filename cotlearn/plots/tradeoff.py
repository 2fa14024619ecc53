"""The frontier: couplings between skew and one-step variance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cotlearn.plots._canvas import open_axes
from cotlearn.plots._placement import place_labels
from cotlearn.plots.style import COLORS, PATH_COLOR, style_of


def frontier(
    points: Iterable[Any],
    *,
    errors: Mapping[str, float] | None = None,
    labels: Mapping[str, str] | None = None,
    curve: Sequence[str] = (),
    ax: Axes | None = None,
    title: str = "",
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
    """
    shown = list(points)
    names = [point.name for point in shown]
    x = np.array([_low_value_high(p.skew, p.skew_interval) for p in shown])
    y = np.array(
        [_low_value_high(p.one_step_variance, p.one_step_variance_interval) for p in shown]
    )
    ax = open_axes(ax, (6.4, 4.2))
    joined = [names.index(name) for name in curve]
    ax.plot(x[joined, 1], y[joined, 1], color=COLORS["conditional_ot"], lw=1.0, alpha=0.5, zorder=1)
    looks = [{**style_of(point.coupling), "linestyle": "none"} for point in shown]
    for look, across, up in zip(looks, x, y, strict=True):
        bars = {"xerr": np.diff(across)[:, None], "yerr": np.diff(up)[:, None]}
        ax.errorbar(across[1], up[1], **bars, elinewidth=1.1, zorder=3, **look)
    if ax.get_autoscaley_on():
        ax.set_ylim(bottom=0)
    ax.axvline(0, color=PATH_COLOR, linewidth=0.8, zorder=0)
    ax.margins(x=0.12, y=0.08)
    ax.grid(True)
    ax.set(xlabel="skew of the noise (0: none)", ylabel="one-step variance", title=title)
    texts = [(labels or {}).get(name, name) for name in names]
    for k, name in enumerate(names):
        if errors and name in errors:
            texts[k] += f"\nerror {errors[name]:.2g}"
    place_labels(ax, x, y, texts, [look["color"] for look in looks])
    return ax


def _low_value_high(value: float, interval: tuple[float, float]) -> list[float]:
    """The ends of an interval, and the value between: rounding may put it beside one."""
    return [min(interval[0], value), value, max(interval[1], value)]
