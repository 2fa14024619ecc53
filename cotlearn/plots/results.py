"""Stored results beside published ones."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_array, refuse_unknown
from cotlearn.plots._canvas import finish, floor_line, open_axes, plain_logarithms
from cotlearn.plots.style import SOURCE_COLOR, label_of, style_of


def beside_published(
    ours: Mapping[str, ArrayLike | Any],
    published: Mapping[str, float],
    *,
    floor: float | None = None,
    labels: Mapping[str, str] | None = None,
    ax: Axes | None = None,
    xlabel: str = "squared $W_2$",
    title: str | None = None,
    legend: bool = True,
) -> Axes:
    """Draw one row a method: the mean of our seeds, filled, and the published number, hollow.

    The line through the mean reaches from the best seed to the worst. The axis is logarithmic.

    Args:
        ours: name -> (seeds,) positive scores, drawn from top to bottom.
        published: name -> a positive score; names among those of ``ours``.
        floor: a dotted line at what true samples score with as many points as ours.
        labels: words for the names where they differ from ``LABELS``.
        ax: where to draw; a new figure by default.
        xlabel: words below.
        title: words above.
        legend: whether to say what filled, hollow and dotted mean.

    Raises:
        ValueError: no scores, scores that are not positive and finite, or a published name
            without a score of ours.
    """
    rows = {name: np.atleast_1d(as_array(v, f"ours[{name!r}]")) for name, v in ours.items()}
    if not rows:
        raise ValueError("ours is empty, expected at least one method")
    refuse_unknown(published, "published", rows)
    scores = {**rows, **{f"published {k}": np.atleast_1d(v) for k, v in published.items()}}
    for name, values in scores.items():
        if values.ndim != 1 or not values.size or not (np.isfinite(values) & (values > 0)).all():
            raise ValueError(
                f"ours, published: {name!r} must have positive finite scores, got {values.tolist()}"
            )
    ax = open_axes(ax, (5.2, 1.1 + 0.34 * len(rows)))
    hollow: dict[str, Any] = {"marker": "D", "markerfacecolor": "white", "linestyle": "none"}
    for row, (name, values) in enumerate(rows.items()):
        look = {key: style_of(name)[key] for key in ("color", "marker")}
        ax.plot([values.min(), values.max()], [row, row], color=look["color"], lw=1.6, alpha=0.6)
        ax.plot(values.mean(), row, linestyle="none", **look)
        if name in published:
            ax.plot(published[name], row, color=look["color"], **hollow)
    if floor is not None:
        floor_line(ax, floor, "our floor", vertical=True)
    if legend:
        ax.plot([], [], "o", color=SOURCE_COLOR, label="here, all seeds")
        ax.plot([], [], color=SOURCE_COLOR, label="published", **hollow)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    ax.set_xscale("log")
    plain_logarithms(ax.xaxis)
    ax.set_yticks(range(len(rows)), [label_of(name, labels) for name in rows])
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.grid(True, axis="x")
    return finish(ax, xlabel=xlabel, title=title)
