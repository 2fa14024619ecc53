"""Bars and histograms."""

from __future__ import annotations

import pytest
import torch

from cotlearn import plots


def test_bars_and_histogram():
    ax = plots.bars(
        {"independent": 1.0, "minibatch_ot": 2.0},
        intervals={"independent": (0.8, 1.2)},
        floor=0.1,
        ylabel="error",
        log=True,
    )
    assert [patch.get_width() for patch in ax.patches] == [1.0, 2.0]
    ax = plots.histogram({"truth": torch.randn(100), "independent": [0.0, 1.0]}, xlabel="x")
    assert len(ax.patches) == 2


BAD_CALLS = {
    "values must be finite": lambda: plots.bars({"truth": float("nan")}, ylabel=""),
    "intervals has": lambda: plots.bars({"a": 1.0}, intervals={"b": (0, 1)}, ylabel=""),
    "finite (n,)": lambda: plots.histogram({"truth": []}, xlabel=""),
    "values is empty": lambda: plots.histogram({}, xlabel=""),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
