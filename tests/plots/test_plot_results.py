"""Our seeds beside published numbers."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cotlearn import plots


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
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        plots.LABELS["independent"],
        plots.LABELS["conditional_ot"],
    ]
    words = [t.get_text() for t in ax.get_legend().get_texts()]
    assert words == ["our floor", "here, all seeds", "published"]
    assert ax.get_xscale() == "log"


def test_one_score_a_method_is_enough():
    ax = plots.beside_published({"reflow": 0.5}, {}, legend=False, labels={"reflow": "again"})
    assert ax.get_legend() is None
    assert ax.get_yticklabels()[0].get_text() == "again"


BAD_CALLS = {
    "ours is empty": lambda: plots.beside_published({}, {}),
    "published has ['b']": lambda: plots.beside_published({"a": 1.0}, {"b": 1.0}),
    "'a' must have positive": lambda: plots.beside_published({"a": [1.0, 0.0]}, {}),
    "'published a' must have": lambda: plots.beside_published({"a": 1.0}, {"a": float("nan")}),
    "'none' must have positive": lambda: plots.beside_published({"none": []}, {}),
    "ours['a'] is None": lambda: plots.beside_published({"a": None}, {}),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
