"""Curves, error and scores against evaluations, histograms."""

import numpy as np
import pytest
import torch
from matplotlib.colors import to_hex

from cotlearn import plots

SCORES = {"independent": {1: [0.7, 0.74], 2: torch.tensor([0.95, 0.94])}, "diffusion": {100: 0.9}}


def without_bars(scores):
    return {name: {} for name in scores}


def line_of(ax, name):
    return next(line for line in ax.get_lines() if line.get_label() == plots.label_of(name))


def test_error_against_nfe_shows_mean_band_and_floor():
    nfe = [1, 2, 4]
    seeds = np.array([[4.0, 2.0, 1.0], [2.0, 1.0, 0.5]])
    errors = {"independent": seeds, "conditional_ot": torch.tensor([0.2, 0.2, 0.1])}
    ax = plots.error_against_nfe(nfe, errors, floor=0.01)
    first, second, floor = ax.get_lines()
    assert np.allclose(first.get_ydata(), [3.0, 1.5, 0.75])
    assert first.get_color() == plots.COLORS["independent"]
    assert second.get_linestyle() == "-"
    assert floor.get_ydata()[0] == 0.01
    assert len(ax.collections) == 1  # a band only where there are several seeds
    assert ax.get_xscale() == ax.get_yscale() == "log"


def test_error_against_nfe_may_be_negative_on_a_linear_axis_and_of_an_unknown_coupling():
    ax = plots.error_against_nfe([1, 2], {"my_own": [0.1, -0.1]}, log=False)
    assert ax.get_yscale() == "linear"
    assert ax.get_legend().get_texts()[0].get_text() == "my_own"


def test_short_numbers_are_written_out_on_logarithmic_axes():
    ax = plots.curves([1, 512], {"truth": [0.2, 3.5]}, xlabel="", ylabel="", log="xy")
    ax.figure.canvas.draw()
    across, up = (
        {text.get_text() for text in axis.get_ticklabels() + axis.get_ticklabels(minor=True)}
        for axis in (ax.xaxis, ax.yaxis)
    )
    assert {"1", "10", "100"} <= across
    assert {"0.2", "0.5", "1", "2"} <= up
    wide = plots.curves([1, 2], {"truth": [1e-8, 1]}, xlabel="", ylabel="", log="y")
    wide.figure.canvas.draw()
    assert any("10^" in text.get_text() for text in wide.get_yticklabels())


def test_scores_have_their_mean_every_seed_and_their_interval():
    intervals = without_bars(SCORES) | {"independent": {1: (0.6, 0.8)}}
    ax = plots.score_against_nfe(SCORES, intervals=intervals, ylabel="coverage")
    line = line_of(ax, "independent")
    assert np.allclose(line.get_ydata(), [0.72, 0.945])
    assert np.allclose(line.get_xdata(), [1, 2], rtol=0.2)
    assert to_hex(line.get_color()).upper() == plots.COLORS["independent"]
    dots = [tuple(offset) for c in ax.collections for offset in c.get_offsets()]
    assert np.allclose(sorted(y for _, y in dots), [0.7, 0.74, 0.9, 0.94, 0.95])
    bar = next(line for line in ax.get_lines() if list(line.get_ydata()) == [0.6, 0.8])
    assert bar.get_xdata()[0] == pytest.approx(line.get_xdata()[0])
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1", "2", "100"]
    assert [t.get_text() for t in ax.get_legend().get_texts()] == list(SCORES)


def test_methods_do_not_cover_each_other():
    same = {name: {1: [0.5]} for name in ("independent", "minibatch_ot", "stratified")}
    ax = plots.score_against_nfe(same, intervals=without_bars(same), ylabel="", legend=False)
    assert ax.get_legend() is None
    assert len({float(line_of(ax, name).get_xdata()[0]) for name in same}) == 3


def test_one_method_stays_at_its_evaluations():
    one = {"reflow": {4: 0.5}}
    ax = plots.score_against_nfe(one, intervals=without_bars(one), ylabel="")
    assert line_of(ax, "reflow").get_xdata()[0] == 4


def test_histograms_share_their_bins():
    ax = plots.histogram({"truth": torch.randn(100), "independent": [0.0, 1.0]}, xlabel="x")
    first, second = ax.patches
    assert first.get_xy()[:, 0].tolist() == second.get_xy()[:, 0].tolist()
