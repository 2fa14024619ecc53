"""Numbers along an axis."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cotlearn import plots


def test_error_against_nfe_shows_mean_band_and_floor():
    nfe = [1, 2, 4]
    seeds = np.array([[4.0, 2.0, 1.0], [2.0, 1.0, 0.5]])
    ax = plots.error_against_nfe(
        nfe, {"independent": seeds, "conditional_ot": torch.tensor([0.2, 0.2, 0.1])}, floor=0.01
    )
    first, second, floor = ax.get_lines()
    assert np.allclose(first.get_ydata(), [3.0, 1.5, 0.75])
    assert first.get_color() == plots.COLORS["independent"]
    assert second.get_linestyle() == "-"
    assert floor.get_ydata()[0] == 0.01
    assert len(ax.collections) == 1  # a band only where there are several seeds
    assert ax.get_xscale() == ax.get_yscale() == "log"


def test_error_against_nfe_on_a_linear_axis_may_be_negative():
    ax = plots.error_against_nfe([1, 2], {"truth": [0.1, -0.1]}, log=False)
    assert ax.get_yscale() == "linear"


def test_an_unknown_coupling_can_be_drawn():
    ax = plots.error_against_nfe([1, 2], {"my_own": [1.0, 0.5]})
    assert ax.get_legend().get_texts()[0].get_text() == "my_own"


def test_curves_and_training_curves():
    ax = plots.curves([1, 2], {"truth": [3, 4]}, xlabel="g", ylabel="error", log="xy")
    assert ax.get_xscale() == "log"
    history = {"step": np.arange(5), "loss": torch.rand(5)}
    assert len(plots.training_curves({"independent": history}).get_lines()) == 2


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


BAD_CALLS = {
    "nfe has": lambda: plots.error_against_nfe([0, 1], {"truth": [1, 1]}),
    "errors['truth'] has": lambda: plots.error_against_nfe([1, 2], {"truth": [1, 1, 1]}),
    "must be finite, and positive": lambda: plots.error_against_nfe([1, 2], {"truth": [1, -1]}),
    "log is": lambda: plots.curves([1], {"truth": [1]}, xlabel="", ylabel="", log="z"),
    "values['truth']": lambda: plots.curves([1], {"truth": [1, 2]}, xlabel="", ylabel=""),
    "step and loss": lambda: plots.training_curves({"truth": {"loss": [1]}}),
    "one length": lambda: plots.training_curves({"truth": {"loss": [1], "step": [1, 2]}}),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
