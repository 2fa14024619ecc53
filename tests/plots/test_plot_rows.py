"""Bars, our seeds beside published numbers, differences and heat maps."""

import numpy as np
import pytest
import torch

from cotlearn import plots


def words(texts):
    return [text.get_text() for text in texts]


def test_bars_are_as_long_as_their_values_and_say_them():
    values = {"independent": 1.0, "minibatch_ot": 0.25}
    ax = plots.bars(values, ylabel="error", log=True)
    assert [patch.get_width() for patch in ax.patches] == [1.0, 0.25]
    assert words(ax.texts) == ["1", "0.25"]
    assert words(ax.get_yticklabels()) == ["independent", "naive OT"]
    assert ax.yaxis_inverted()


def test_each_method_has_its_mean_its_range_and_the_published_number():
    ours = {"independent": [1.0, 2.0, 3.0], "conditional_ot": torch.tensor([0.1, 0.2])}
    ax = plots.beside_published(ours, {"independent": 2.5}, floor=0.05, title="toy")
    line, mean, published, second, second_mean, floor, *_ = ax.get_lines()
    assert list(line.get_xdata()) == [1.0, 3.0]
    assert mean.get_xdata()[0] == 2.0
    assert mean.get_color() == plots.COLORS["independent"]
    assert published.get_xdata()[0] == 2.5
    assert published.get_markerfacecolor() == "white"
    assert np.allclose(second.get_xdata(), [0.1, 0.2])
    assert second_mean.get_ydata()[0] == 1
    assert floor.get_xdata()[0] == 0.05
    assert words(ax.get_yticklabels()) == ["independent", "conditional OT (COT)"]
    assert words(ax.get_legend().get_texts()) == ["our floor", "here, all seeds", "published"]
    assert ax.get_xscale() == "log"


def test_one_score_a_method_is_enough():
    ax = plots.beside_published({"reflow": 0.5}, {}, legend=False, labels={"reflow": "again"})
    assert ax.get_legend() is None
    assert ax.get_yticklabels()[0].get_text() == "again"


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
    assert words(ax.get_yticklabels()) == list(rows)


def test_a_heat_map_says_its_numbers_and_leaves_out_what_is_not_there():
    table, names = [[0.5, 0.9], [np.nan, 0.7]], {"rows": [500, 1000], "columns": [64, 512]}
    ax = plots.strata_heatmap(table, **names, limits=(0.5, 1), title="1")
    assert words(ax.texts) == ["0.50", "0.90", "0.70"]
    assert [t.get_color() for t in ax.texts] == ["white", "#222222", "white"]
    assert ax.get_images()[0].get_clim() == (0.5, 1)
    assert words(ax.get_yticklabels()) == ["500", "1000"]
    assert words(ax.get_xticklabels()) == ["64", "512"]


def test_a_heat_map_of_one_value():
    assert words(plots.strata_heatmap([[3.0]], rows=["a"], columns=["b"], digits=0).texts) == ["3"]


def test_a_heat_map_needs_a_name_for_each_row_and_column():
    with pytest.raises(ValueError, match=r"expected an array of shape \(1, 2\), got \(1, 1\)"):
        plots.strata_heatmap([[1.0]], rows=[1], columns=[1, 2])
