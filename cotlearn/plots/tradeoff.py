"""The frontier: skew against one-step variance of couplings."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from cotlearn.plots._canvas import Array, open_axes
from cotlearn.plots.style import COLORS, PATH_COLOR, readable, style_of

#: Where a text may stand: a distance from its point in points of an inch, and a direction.
_DISTANCES = np.repeat([8, 14, 22, 32, 44, 58, 76, 98, 124, 150], 8)
_ANGLES = np.deg2rad(np.tile([0, 180, 35, -35, 145, -145, 90, -90], 10))
_DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)]).round(9)
#: The share of the text that lies before its anchor: it grows away from the point.
_SHARES = (1 - np.sign(_DIRECTIONS)) / 2


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

    Bars are the 95 % intervals. Points of significant skew are hollow. Names stand beside the
    points and cover neither each other nor the line.

    Args:
        points: a `diagnostics.Frontier`, or anything with the attributes of its points: name,
            coupling, skew, skew_interval, flagged, one_step_variance, one_step_variance_interval.
        errors: name -> a measured error that is written below the name.
        labels: words where they differ from the names.
        curve: names that a line joins in this order: a sweep of weights.
        ax: Axes to draw into; a new figure by default. Its size and limits should be set before.
        title: title of the panel.
    """
    shown = list(points)
    names = [point.name for point in shown]
    x = np.array([_with_ends(p.skew, p.skew_interval) for p in shown])
    y = np.array([_with_ends(p.one_step_variance, p.one_step_variance_interval) for p in shown])
    ax = open_axes(ax, (6.4, 4.2))
    joined = [names.index(name) for name in curve]
    ax.plot(x[joined, 1], y[joined, 1], color=COLORS["conditional_ot"], lw=1.0, alpha=0.5, zorder=1)
    looks = [{**style_of(point.coupling), "linestyle": "none"} for point in shown]
    for look, point, across, up in zip(looks, shown, x, y, strict=True):
        bars = {"xerr": np.diff(across)[:, None], "yerr": np.diff(up)[:, None]}
        fill = "white" if point.flagged else look["color"]
        ax.errorbar(across[1], up[1], **bars, elinewidth=1.1, zorder=3, mfc=fill, **look)
    if ax.get_autoscaley_on():
        ax.set_ylim(bottom=0)
    ax.axvline(0, color=PATH_COLOR, linewidth=0.8, zorder=0)
    ax.margins(x=0.12, y=0.08)
    ax.grid(True)
    hollow = "; hollow: significant" * any(point.flagged for point in shown)
    ax.set(xlabel=f"skew of the noise (0: none{hollow})", ylabel="one-step variance", title=title)
    below = {name: f"\nerror {value:.2g}" for name, value in (errors or {}).items()}
    texts = [(labels or {}).get(name, name) + below.get(name, "") for name in names]
    line = np.column_stack([x[joined, 1], y[joined, 1]])
    _annotate(ax, x, y, line, texts, [look["color"] for look in looks])
    return ax


def _with_ends(value: float, interval: tuple[float, float]) -> list[float]:
    """The ends of an interval, and the value between: rounding may put it beside one."""
    return [min(interval[0], value), value, max(interval[1], value)]


def _annotate(
    ax: Axes, x: Array, y: Array, line: Array, texts: Sequence[str], colors: Sequence[str]
) -> None:
    """Write each text near its point, at the nearest of many positions that is still free.

    x and y are (n, 3): low end, value and high end of the error bars; line is (m, 2).
    """
    figure: Any = ax.figure.get_figure(root=True)
    figure.draw_without_rendering()  # so that the layout is final and pixels mean something
    panel, point = np.array(ax.get_window_extent().extents), figure.dpi / 72
    low, at, high = (ax.transData.transform(np.column_stack([x[:, k], y[:, k]])) for k in range(3))
    along = ax.transData.transform(line) if len(line) else np.empty((0, 2))
    along = np.linspace(along[:-1], along[1:], 100).reshape(-1, 2)
    taken = np.vstack(  # by the line, markers and bars: rows of left, bottom, right and top
        [
            np.hstack([along - point, along + point]),
            np.hstack([at - 5 * point, at + 5 * point]),
            np.column_stack([low[:, 0], at[:, 1] - point, high[:, 0], at[:, 1] + point]),
            np.column_stack([at[:, 0] - point, low[:, 1], at[:, 0] + point, high[:, 1]]),
        ]
    )
    for k in np.argsort(-at[:, 1]):
        note = ax.annotate(
            texts[k],
            (x[k, 1], y[k, 1]),
            (0, 0),
            textcoords="offset points",
            fontsize=8,
            color=readable(colors[k]),
            in_layout=False,
            path_effects=[withStroke(linewidth=2.0, foreground="white")],  # over lines and bars
            zorder=5,
        )
        size = np.array(note.get_window_extent().size)
        corners = at[k] + point * _DISTANCES[:, None] * _DIRECTIONS - size * _SHARES
        boxes = np.hstack([corners, corners + size])
        covered = _common_area(boxes[:, None], taken).sum(axis=1)
        outside = _common_area(boxes, panel) < 0.999 * size.prod()
        best = np.argmin(_DISTANCES + 10 * covered + 10_000 * outside)
        note.xyann = tuple(_DISTANCES[best] * _DIRECTIONS[best])
        across, up = (2 * _SHARES[best]).astype(int)
        note.set(ha=("left", "center", "right")[across], va=("bottom", "center", "top")[up])
        if _DISTANCES[best] > 14:
            nearest = np.clip(at[k], boxes[best, :2], boxes[best, 2:])
            line = ax.transData.inverted().transform([at[k], nearest])
            ax.add_line(Line2D(*line.T, color=colors[k], lw=0.6, alpha=0.6, zorder=2))
        taken = np.vstack([taken, boxes[best]])


def _common_area(first: Array, second: Array) -> Array:
    """The area in pixels that boxes (..., 4) share."""
    low = np.maximum(first[..., :2], second[..., :2])
    high = np.minimum(first[..., 2:], second[..., 2:])
    return np.clip(high - low, 0, None).prod(axis=-1)
