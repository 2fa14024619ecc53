"""Policies: against evaluations and latency, against a reference, over strata."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from matplotlib.colors import to_hex

from cotlearn import plots

SCORES = {
    "independent": {1: [0.7, 0.74], 2: torch.tensor([0.95, 0.94])},
    "diffusion": {100: 0.9},
}
LATENCY = {"independent": {1: 0.4, 2: 0.8}, "diffusion": {100: 60.0}}


def line_of(ax, name):
    return next(line for line in ax.get_lines() if line.get_label() == plots.LABELS[name])


def test_scores_have_their_mean_every_seed_and_their_interval():
    intervals = {"independent": {1: (0.6, 0.8)}}
    ax = plots.score_against_nfe(SCORES, intervals=intervals, title="toy")
    line = line_of(ax, "independent")
    assert np.allclose(line.get_ydata(), [0.72, 0.945])
    assert np.allclose(line.get_xdata(), [1, 2], rtol=0.2)
    assert to_hex(line.get_color()).upper() == plots.COLORS["independent"]
    dots = [tuple(offset) for c in ax.collections for offset in c.get_offsets()]
    assert np.allclose(sorted(y for _, y in dots), [0.7, 0.74, 0.9, 0.94, 0.95])
    bar = next(line for line in ax.get_lines() if list(line.get_ydata()) == [0.6, 0.8])
    assert bar.get_xdata()[0] == pytest.approx(line.get_xdata()[0])
    assert [t.get_text() for t in ax.get_xticklabels()] == ["1", "2", "100"]
    words = [t.get_text() for t in ax.get_legend().get_texts()]
    assert words == [plots.LABELS["independent"], plots.LABELS["diffusion"]]


def test_methods_do_not_cover_each_other():
    same = {name: {1: [0.5]} for name in ("independent", "minibatch_ot", "stratified")}
    ax = plots.score_against_nfe(same, legend=False)
    assert ax.get_legend() is None
    assert len({float(line_of(ax, name).get_xdata()[0]) for name in same}) == 3


def test_one_method_stays_at_its_evaluations():
    ax = plots.score_against_nfe({"reflow": {4: 0.5}}, labels={"reflow": "independent"})
    assert line_of(ax, "independent").get_xdata()[0] == 4


def test_latency_has_the_evaluations_written_beside():
    ax = plots.score_against_latency(LATENCY, SCORES, deadline=100.0)
    line = line_of(ax, "independent")
    assert np.allclose(line.get_xdata(), [0.4, 0.8])
    assert np.allclose(line.get_ydata(), [0.72, 0.945])
    assert sorted(t.get_text() for t in ax.texts) == [" deadline", "1", "100", "2"]
    assert ax.get_xscale() == "log"


def test_numbers_of_evaluations_do_not_stand_on_each_other():
    latency = {name: {1: 1.0, 16: 8.0} for name in ("independent", "minibatch_ot")}
    scores = {"independent": {1: [0.50], 16: [0.9]}, "minibatch_ot": {1: [0.505], 16: [0.3]}}
    ax = plots.score_against_latency(latency, scores)
    assert [(t.get_text(), t.xy) for t in ax.texts] == [
        ("16", (8.0, 0.9)),
        ("1", (1.0, 0.505)),
        ("16", (8.0, 0.3)),
    ]


def test_differences_stand_beside_zero_and_the_margin():
    rows = {"independent, 2": (0.003, -0.01, 0.02), "naive, 2": (-0.57, -0.6, -0.5)}
    methods = {"independent, 2": "independent", "naive, 2": "minibatch_ot"}
    ax = plots.differences(rows, methods=methods, margin=0.02, xlabel="coverage")
    zero, margin, bar, dot, _, naive = ax.get_lines()
    assert zero.get_xdata()[0] == 0
    assert margin.get_xdata()[0] == -0.02
    assert list(bar.get_xdata()) == [-0.01, 0.02]
    assert dot.get_xdata()[0] == 0.003
    assert naive.get_color() == plots.COLORS["minibatch_ot"]
    assert [t.get_text() for t in ax.get_yticklabels()] == list(rows)


def test_a_heat_map_says_its_numbers_and_leaves_out_what_is_not_there():
    table = [[0.5, 0.9], [np.nan, 0.7]]
    ax = plots.strata_heatmap(
        table, rows=[500, 1000], columns=[64, 512], limits=(0.5, 1), title="1"
    )
    assert [t.get_text() for t in ax.texts] == ["0.50", "0.90", "0.70"]
    assert [t.get_color() for t in ax.texts] == ["white", "#222222", "white"]
    image = ax.get_images()[0]
    assert image.get_clim() == (0.5, 1)
    assert [t.get_text() for t in ax.get_yticklabels()] == ["500", "1000"]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["64", "512"]


def test_a_heat_map_of_one_value():
    ax = plots.strata_heatmap([[3.0]], rows=["a"], columns=["b"], digits=0)
    assert ax.texts[0].get_text() == "3"


BAD_CALLS = {
    "scores is empty": lambda: plots.score_against_nfe({}),
    "scores['a'][0] must be finite": lambda: plots.score_against_nfe({"a": {0: 1.0}}),
    "scores['a'][1] must be finite": lambda: plots.score_against_nfe({"a": {1: [np.nan]}}),
    "intervals has ['b']": lambda: plots.score_against_nfe({"a": {1: 1.0}}, intervals={"b": {}}),
    "intervals['a'] has 2": lambda: plots.score_against_nfe(
        {"a": {1: 1.0}}, intervals={"a": {2: (0.0, 1.0)}}
    ),
    "the same methods": lambda: plots.score_against_latency({"a": {1: 1.0}}, {"a": {2: 1.0}}),
    "and some": lambda: plots.score_against_latency({}, {}),
    "latency['a'] must be positive": lambda: plots.score_against_latency(
        {"a": {1: 0.0}}, {"a": {1: 1.0}}
    ),
    "rows is empty": lambda: plots.differences({}, xlabel="x"),
    "rows['a'] must be three": lambda: plots.differences({"a": (0.0, np.inf, 1.0)}, xlabel="x"),
    "methods has ['b']": lambda: plots.differences(
        {"a": (0.0, 0.0, 1.0)}, methods={"b": "reflow"}, xlabel="x"
    ),
    "expected (1, 2)": lambda: plots.strata_heatmap([[1.0]], rows=[1], columns=[1, 2]),
    "no finite cell": lambda: plots.strata_heatmap([[np.nan]], rows=[1], columns=[1]),
    "limits must rise": lambda: plots.strata_heatmap(
        [[1.0]], rows=[1], columns=[1], limits=(1.0, 1.0)
    ),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
