"""Numbers along an axis: error against steps, sweeps, and training."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from cotlearn.plots._arrays import as_array
from cotlearn.plots._canvas import CHART, finish, floor_line, open_axes, plain_logarithms
from cotlearn.plots.style import label_of, style_of


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
    steps = as_array(nfe, "nfe")
    if steps.ndim != 1 or len(steps) < 1 or steps.min() < 1:
        raise ValueError(f"nfe has shape {steps.shape}, expected (m,) with values of at least 1")
    curves = {name: np.atleast_2d(as_array(v, f"errors[{name!r}]")) for name, v in errors.items()}
    for name, curve in curves.items():
        if curve.ndim != 2 or curve.shape[1] != len(steps):
            raise ValueError(
                f"errors[{name!r}] has shape {curve.shape}, "
                f"expected ({len(steps)},) or (seeds, {len(steps)})"
            )
        if not np.isfinite(curve).all() or (log and (curve <= 0).any()):
            raise ValueError(f"errors[{name!r}] must be finite, and positive on a logarithmic axis")
    ax = open_axes(ax, CHART)
    for name, curve in curves.items():
        look = style_of(name)
        if len(curve) > 1:
            band = (curve.min(0), curve.max(0))
            ax.fill_between(steps, *band, color=look["color"], alpha=0.18, lw=0)
        ax.plot(steps, curve.mean(0), label=label_of(name, labels), **look)
    if floor is not None:
        floor_line(ax, floor, floor_label)
    ax.set_xscale("log", base=2)
    if log:
        ax.set_yscale("log")
        plain_logarithms(ax.yaxis)
    ax.set_xticks(steps, [f"{s:g}" for s in steps])
    ax.minorticks_off()
    ax.grid(True)
    words = "network evaluations per sample (NFE)"
    return finish(ax, xlabel=words, ylabel=ylabel, title=title, legend=legend)


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
    position = as_array(x, "x")
    lines = {name: as_array(v, f"values[{name!r}]") for name, v in values.items()}
    for name, line in lines.items():
        if position.ndim != 1 or line.shape != position.shape:
            raise ValueError(
                f"values[{name!r}] has shape {line.shape}, expected that of x, {position.shape}"
            )
    ax = open_axes(ax, CHART)
    for name, line in lines.items():
        ax.plot(position, line, label=label_of(name, labels), **style_of(name))
    if "x" in log:
        ax.set_xscale("log")
        plain_logarithms(ax.xaxis)
    if "y" in log:
        ax.set_yscale("log")
        plain_logarithms(ax.yaxis)
    ax.grid(True)
    return finish(ax, xlabel=xlabel, ylabel=ylabel, title=title, legend=legend)


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
        step, loss = as_array(history["step"], "step"), as_array(history["loss"], "loss")
        if step.ndim != 1 or step.shape != loss.shape:
            raise ValueError(
                f"histories[{name!r}]: step has shape {step.shape}, loss {loss.shape}; "
                "expected two vectors of one length"
            )
        lines[name] = (step, loss)
    ax = open_axes(ax, CHART)
    for name, (step, loss) in lines.items():
        look = {**style_of(name), "marker": None}
        ax.plot(step, loss, color=look["color"], linewidth=0.7, alpha=0.3)
        window = max(1, len(loss) // 40)
        mean = np.convolve(loss, np.ones(window) / window, mode="valid")
        ax.plot(step[window - 1 :], mean, label=label_of(name), **look)
    ax.set_ylim(bottom=0)
    ax.grid(True, axis="y")
    return finish(ax, xlabel="training step", ylabel=ylabel, title=title, legend=True)
