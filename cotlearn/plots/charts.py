"""Numbers along an axis: sweeps, error and score against evaluations, histograms."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from cotlearn.plots._canvas import Numbers, as_array, legend_beside, logarithmic, open_axes
from cotlearn.plots.style import FLOOR, label_of, style_of

Scores = Mapping[str, Mapping[int, Numbers]]


def curves(
    x: Numbers,
    values: Mapping[str, Numbers],
    *,
    floor: float | None = None,
    floor_label: str = "floor: truth against truth",
    ax: Axes | None = None,
    xlabel: str,
    ylabel: str,
    title: str = "",
    labels: Mapping[str, str] | None = None,
    log: str = "",
    legend: bool = True,
) -> Axes:
    """Plot named curves over one horizontal axis, in the colours of their couplings.

    Args:
        x: (m,) positions.
        values: name -> (m,) values of one seed, or (seeds, m); the line is the mean over seeds,
            the band reaches from the smallest to the largest.
        floor: a dotted line at the smallest value that can be expected.
        floor_label: label of the floor.
        ax: Axes to draw into; a new figure by default.
        xlabel: label of the horizontal axis.
        ylabel: label of the vertical axis.
        title: title of the figure.
        labels: name -> legend label, if it differs from ``label_of``.
        log: "", "x", "y" or "xy": the axes that are logarithmic.
        legend: whether to draw the legend.
    """
    position = as_array(x, "m")
    ax = open_axes(ax)
    for name, value in values.items():
        seeds, look = np.atleast_2d(as_array(value)), style_of(name)
        if len(seeds) > 1:
            band = (seeds.min(0), seeds.max(0))
            ax.fill_between(position, *band, color=look["color"], alpha=0.18, lw=0)
        ax.plot(position, seeds.mean(0), label=label_of(name, labels), **look)
    if floor is not None:
        ax.axhline(floor, label=floor_label, **FLOOR)
    logarithmic(ax, log)
    ax.grid(True)
    ax.set(xlabel=xlabel, ylabel=ylabel, title=title)
    if legend:
        ax.legend()
    return ax


def error_against_nfe(
    nfe: Sequence[int],
    errors: Mapping[str, Numbers],
    *,
    ylabel: str = "squared conditional $W_2$",
    log: bool = True,
    **options: Any,
) -> Axes:
    """Plot error against the number of network evaluations, both on logarithmic axes.

    Args:
        nfe: (m,) numbers of evaluations.
        errors: name of the coupling -> (m,) or (seeds, m), as in :func:`curves`.
        ylabel: label of the vertical axis.
        log: whether the error's axis is logarithmic.
        options: more of :func:`curves`: floor, floor_label, ax, title, labels, legend.
    """
    words = "network evaluations per sample (NFE)"
    ax = curves(nfe, errors, xlabel=words, ylabel=ylabel, log="y" if log else "", **options)
    return _axis_of_evaluations(ax, nfe)


def score_against_nfe(
    scores: Scores,
    *,
    intervals: Mapping[str, Mapping[int, tuple[float, float]]],
    ax: Axes | None = None,
    ylabel: str,
    legend: bool = True,
) -> Axes:
    """Plot scores against network evaluations: a line through the means, a dot for every seed.

    Methods are shifted slightly sideways so that their dots and bars do not overlap.

    Args:
        scores: method -> evaluations -> (seeds,) scores; methods may have different evaluations.
        intervals: the same keys -> (low, high), drawn as bars.
        ax: Axes to draw into; a new figure by default.
        ylabel: label of the vertical axis.
        legend: whether to draw the legend, to the right.
    """
    ax = open_axes(ax)
    shifts = 2 ** np.linspace(-0.15, 0.15, len(scores)) if len(scores) > 1 else [1.0]
    for shift, (name, curve) in zip(shifts, scores.items(), strict=True):
        look, nfes = style_of(name), sorted(curve)
        for nfe, (low, high) in intervals[name].items():
            ax.plot([nfe * shift] * 2, [low, high], color=look["color"], lw=1.2, alpha=0.7)
        for nfe in nfes:
            across, up = np.broadcast_arrays(nfe * shift, as_array(curve[nfe]))
            ax.scatter(across, up, s=9, color=look["color"], alpha=0.6, linewidths=0)
        means = [as_array(curve[nfe]).mean() for nfe in nfes]
        ax.plot(shift * np.array(nfes), means, label=label_of(name), **look)
    ax.set(xlabel="network evaluations per chunk (NFE)", ylabel=ylabel)
    if legend:
        legend_beside(ax)
    return _axis_of_evaluations(ax, sorted({nfe for curve in scores.values() for nfe in curve}))


def histogram(values: Mapping[str, Numbers], *, bins: int = 40, xlabel: str) -> Axes:
    """Draw outlined histograms of several samples over common bins, as densities.

    Args:
        values: name -> (n,) numbers.
        bins: number of common bins.
        xlabel: label of the horizontal axis.
    """
    samples = {name: as_array(value, "n") for name, value in values.items()}
    edges = list(np.histogram_bin_edges(np.concatenate(list(samples.values())), bins))
    ax = open_axes(None, (5.2, 3.0))
    for name, sample in samples.items():
        look = {key: style_of(name)[key] for key in ("color", "linestyle")}
        ax.hist(sample, edges, density=True, histtype="step", lw=1.6, label=label_of(name), **look)
    ax.margins(y=0.28)  # room for the legend
    ax.set(xlabel=xlabel, ylabel="density")
    ax.legend()
    return ax


def _axis_of_evaluations(ax: Axes, nfes: Sequence[int]) -> Axes:
    ax.set_xscale("log", base=2)
    ax.set_xticks(nfes, [f"{nfe:g}" for nfe in nfes])
    ax.minorticks_off()
    ax.grid(True)
    return ax
