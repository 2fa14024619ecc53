"""Every method keeps one look, and a stranger's look is its own."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.markers import MarkerStyle

from cotlearn import plots
from cotlearn.plots.style import CONDITION_MARKERS, readable

METHOD_NAMES = {
    *("independent", "minibatch_ot", "conditional_ot", "adaptive", "stratified", "residual"),
    *("centred", "semidiscrete", "aligned", "reflow", "reflow_inverted", "mean_flow"),
    *("mean_flow_residual", "shortcut", "shortcut_residual", "two_passes", "diffusion"),
    *("diffusion_residual", "behaviour_cloning", "truth"),
    *("adaptive_weights", "adaptive_weights_residual", "mean_flow_data"),
    *("mean_flow_data_residual", "drifting"),
}


def test_every_method_has_one_colour_marker_line_and_label():
    assert set(plots.LOOKS) == set(plots.COLORS) == METHOD_NAMES
    for sign in zip(*plots.LOOKS.values(), strict=True):
        assert len(set(sign)) == len(METHOD_NAMES)
    assert len(set(plots.CONDITION_COLORS)) == len(set(CONDITION_MARKERS)) == 10


def test_every_marker_can_be_drawn():
    for look in plots.LOOKS.values():
        assert MarkerStyle(look.marker).get_path() is not None


def test_use_style_changes_the_figure():
    plt.rcdefaults()
    plots.use_style()
    assert not plt.rcParams["axes.spines.top"]


def test_colours_are_valid():
    for color in (*plots.COLORS.values(), *plots.CONDITION_COLORS):
        assert len(to_rgb(color)) == 3


def test_small_text_is_readable_on_white():
    for color in plots.COLORS.values():
        rgb = np.array(to_rgb(readable(color)))
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        assert 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) > 4.4
    assert readable("#0072B2") == "#0072b2"  # dark enough as it is


def test_strangers_get_looks_of_their_own_and_keep_them():
    names = [f"stranger {k}" for k in range(40)]
    looks = [str(plots.style_of(name)) for name in names]
    known = {str(plots.style_of(name)) for name in plots.COLORS}
    assert len({*looks, *known}) == len(names) + len(known)
    assert [str(plots.style_of(name)) for name in names] == looks


def test_two_strangers_in_one_figure_differ_in_all_three_signs():
    first, second = (plots.style_of(f"neighbour {k}") for k in range(2))
    assert all(first[sign] != second[sign] for sign in ("color", "marker", "linestyle"))
    to_rgb(first["color"])


def test_labels_that_are_given_come_first():
    assert plots.label_of("independent", {"independent": "CFM"}) == "CFM"
    assert plots.label_of("independent", {"reflow": "again"}) == "independent"
    assert plots.label_of("my own") == "my own"


def test_every_public_name_is_there_and_only_those():
    assert sorted(plots.__all__) == sorted(set(plots.__all__))
    assert all(hasattr(plots, name) for name in plots.__all__)
