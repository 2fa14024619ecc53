"""What policies are worth: against evaluations and latency, against a reference, over strata."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike, NDArray

from cotlearn.plots._arrays import as_array, refuse_unknown
from cotlearn.plots._canvas import CHART, finish, open_axes, plain_logarithms
from cotlearn.plots.style import PATH_COLOR, SOURCE_COLOR, label_of, style_of

Scores = Mapping[str, Mapping[int, ArrayLike | Any]]
Interval = tuple[float, float]


def score_against_nfe(
    scores: Scores,
    *,
    intervals: Mapping[str, Mapping[int, Interval]] | None = None,
    ax: Axes | None = None,
    title: str | None = None,
    ylabel: str = "mean best coverage",
    labels: Mapping[str, str] | None = None,
    legend: bool = True,
) -> Axes:
    """Plot scores against network evaluations: a line through the means, a dot for every seed.

    Methods are shifted a little sideways, so that their dots and bars do not cover each other.

    Args:
        scores: method -> evaluations -> (seeds,) scores; methods may have different evaluations.
        intervals: method -> evaluations -> (low, high), drawn as bars.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        ylabel: words beside.
        labels: words for the legend where they differ from ``LABELS``.
        legend: whether to draw the legend, to the right.

    Raises:
        ValueError: no scores, scores that are not finite, evaluations below 1, or an interval
            without its score.
    """
    means = {name: _means(curve, f"scores[{name!r}]") for name, curve in scores.items()}
    if not means:
        raise ValueError("scores is empty, expected at least one method")
    refuse_unknown(intervals, "intervals", means)
    ax = open_axes(ax, CHART)
    for rank, (name, curve) in enumerate(means.items()):
        look = style_of(name)
        shift = 2 ** (0.3 * (rank / max(len(means) - 1, 1) - 0.5))
        shift = shift if len(means) > 1 else 1.0
        for nfe, (low, high) in (intervals or {}).get(name, {}).items():
            if nfe not in curve:
                raise ValueError(f"intervals[{name!r}] has {nfe}, scores only {sorted(curve)}")
            ax.plot([nfe * shift] * 2, [low, high], color=look["color"], lw=1.2, alpha=0.7)
        for nfe in curve:
            each = np.atleast_1d(as_array(scores[name][nfe], name))
            dots: dict[str, Any] = {"s": 9, "color": look["color"], "alpha": 0.6, "linewidths": 0}
            ax.scatter(np.full(len(each), nfe * shift), each, **dots)
        nfes = sorted(curve)
        at = [nfe * shift for nfe in nfes]
        ax.plot(at, [curve[nfe] for nfe in nfes], label=label_of(name, labels), **look)
    _axis_of_evaluations(ax, sorted({nfe for curve in means.values() for nfe in curve}))
    finish(ax, xlabel="network evaluations per chunk (NFE)", ylabel=ylabel, title=title)
    if legend:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def score_against_latency(
    latency: Mapping[str, Mapping[int, float]],
    scores: Scores,
    *,
    deadline: float | None = None,
    ax: Axes | None = None,
    title: str | None = None,
    ylabel: str = "mean best coverage",
    labels: Mapping[str, str] | None = None,
) -> Axes:
    """Plot scores against the milliseconds that a chunk takes.

    The numbers are the evaluations, where there is room for one.

    Args:
        latency: method -> evaluations -> milliseconds, above 0.
        scores: the same keys -> (seeds,) scores.
        deadline: milliseconds, a dotted line.
        ax: where to draw; a new figure by default.
        title: words above the panel.
        ylabel: words beside.
        labels: words for the legend where they differ from ``LABELS``.

    Raises:
        ValueError: no latencies, keys that do not match, or values that are not finite or not
            positive.
    """
    keys = {name: sorted(each) for name, each in latency.items()}
    if not keys or keys != {name: sorted(each) for name, each in scores.items()}:
        raise ValueError("latency and scores must have the same methods and evaluations, and some")
    ax = open_axes(ax, CHART)
    marks: list[tuple[int, float, float, Any]] = []
    for name, nfes in keys.items():
        means = _means(scores[name], f"scores[{name!r}]")
        x = np.array([latency[name][nfe] for nfe in nfes], dtype=np.float64)
        if not (np.isfinite(x) & (x > 0)).all():
            raise ValueError(f"latency[{name!r}] must be positive and finite, got {x.tolist()}")
        look = style_of(name)
        ax.plot(x, [means[nfe] for nfe in nfes], label=label_of(name, labels), **look)
        marks += [(nfe, at, means[nfe], look["color"]) for nfe, at in zip(nfes, x, strict=True)]
    if deadline is not None:
        ax.axvline(deadline, color=SOURCE_COLOR, linestyle=":", linewidth=1.2)
        anchor = (deadline, 0.02)
        ax.annotate(" deadline", anchor, xycoords=("data", "axes fraction"), fontsize=8)
    ax.set_xscale("log")
    plain_logarithms(ax.xaxis)
    _number(ax, marks)
    ax.grid(True)
    finish(ax, xlabel="milliseconds for a chunk", ylabel=ylabel, title=title)
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


def _number(ax: Axes, marks: Sequence[tuple[int, float, float, Any]]) -> None:
    """Write evaluations (number, x, y, colour) above points, highest first, none on another."""
    taken: list[NDArray[np.float64]] = []
    for nfe, x, y, color in sorted(marks, key=lambda mark: -mark[2]):
        place = ax.transData.transform((x, y)) * 72 / ax.figure.dpi  # points
        if any((np.abs(place - other) < (14, 11)).all() for other in taken):
            continue
        taken.append(place)
        words: dict[str, Any] = {"fontsize": 7.5, "color": color, "ha": "center"}
        ax.annotate(f"{nfe}", (x, y), (0, 5), textcoords="offset points", **words)


def differences(
    rows: Mapping[str, tuple[float, float, float]],
    *,
    methods: Mapping[str, str] | None = None,
    margin: float | None = None,
    ax: Axes | None = None,
    xlabel: str,
    title: str | None = None,
) -> Axes:
    """Draw one row a difference to a reference: its value and interval, with a line at zero.

    Args:
        rows: words -> (mean, low, high), drawn from top to bottom.
        methods: words -> the method whose colour and marker the row has.
        margin: a dotted line at -margin: what may be lost.
        ax: where to draw; a new figure by default.
        xlabel: words below.
        title: words above.

    Raises:
        ValueError: no rows, values that are not finite, or methods for unknown rows.
    """
    values = {name: as_array(row, f"rows[{name!r}]") for name, row in rows.items()}
    for name, value in values.items():
        if value.shape != (3,) or not np.isfinite(value).all():
            raise ValueError(f"rows[{name!r}] must be three finite numbers, got {value.tolist()}")
    if not values:
        raise ValueError("rows is empty, expected at least one difference")
    refuse_unknown(methods, "methods", values)
    ax = open_axes(ax, (5.6, 1.0 + 0.24 * len(values)))
    ax.axvline(0, color=PATH_COLOR, linewidth=0.9, zorder=0)
    if margin is not None:
        ax.axvline(-margin, color=SOURCE_COLOR, linestyle=":", linewidth=1.1, zorder=0)
    for rank, (name, (mean, low, high)) in enumerate(values.items()):
        look = style_of((methods or {}).get(name, name))
        ax.plot([low, high], [rank, rank], color=look["color"], linewidth=1.6)
        ax.plot(mean, rank, color=look["color"], marker=look["marker"])
    ax.set_yticks(range(len(values)), list(values))
    ax.set_ylim(len(values) - 0.4, -0.6)
    ax.grid(True, axis="x")
    ax.locator_params(axis="x", nbins=5)  # the words beside leave little room
    return finish(ax, xlabel=xlabel, title=title)


def strata_heatmap(
    values: ArrayLike | Any,
    *,
    rows: Sequence[Any],
    columns: Sequence[Any],
    limits: Interval | None = None,
    digits: int = 2,
    ax: Axes | None = None,
    xlabel: str = "strata",
    ylabel: str = "episodes",
    title: str | None = None,
) -> Axes:
    """Draw a table as coloured cells with their numbers: bright is large.

    Args:
        values: (rows, columns); NaN for cells that are not there.
        rows: what the rows stand for, from top to bottom.
        columns: what the columns stand for.
        limits: the values that are darkest and brightest; the smallest and largest by default.
        digits: after the point.
        ax: where to draw; a new figure by default.
        xlabel: words below.
        ylabel: words beside.
        title: words above.

    Raises:
        ValueError: the shape does not fit, no cell has a number, or limits that do not rise.
    """
    table = as_array(values, "values")
    if table.shape != (len(rows), len(columns)):
        raise ValueError(
            f"values has shape {table.shape}, expected {(len(rows), len(columns))}, one number "
            "for each of rows and columns"
        )
    if not np.isfinite(table).any():
        raise ValueError("values has no finite cell")
    low, high = limits or (float(np.nanmin(table)), float(np.nanmax(table)))
    if limits is not None and not low < high:
        raise ValueError(f"limits must rise, got {limits}")
    ax = open_axes(ax, (1.2 + 0.75 * len(columns), 1.0 + 0.6 * len(rows)))
    ax.imshow(table, vmin=low, vmax=high, aspect="auto")
    for (i, j), value in np.ndenumerate(table):
        if np.isfinite(value):
            bright = value > (low + high) / 2
            shade = SOURCE_COLOR if bright else "white"
            ax.text(j, i, f"{value:.{digits}f}", ha="center", va="center", color=shade)
    ax.set_xticks(range(len(columns)), [str(column) for column in columns])
    ax.set_yticks(range(len(rows)), [str(row) for row in rows])
    ax.grid(False)
    return finish(ax, xlabel=xlabel, ylabel=ylabel, title=title)


def _means(curve: Mapping[int, ArrayLike | Any], name: str) -> dict[int, float]:
    """evaluations -> mean over seeds, of scores that are finite."""
    means = {}
    for nfe, values in curve.items():
        each: NDArray[np.float64] = np.atleast_1d(as_array(values, f"{name}[{nfe}]"))
        if nfe < 1 or each.ndim != 1 or not each.size or not np.isfinite(each).all():
            raise ValueError(
                f"{name}[{nfe}] must be finite scores (seeds,) for 1 evaluation or more, got "
                f"{each.tolist()}"
            )
        means[nfe] = float(each.mean())
    return means


def _axis_of_evaluations(ax: Axes, nfes: Sequence[int]) -> None:
    ax.set_xscale("log", base=2)
    ax.set_xticks(nfes, [f"{nfe:g}" for nfe in nfes])
    ax.minorticks_off()
    ax.grid(True)
