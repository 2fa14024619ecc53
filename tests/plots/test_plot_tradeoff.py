"""The frontier."""

from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.text import Text

from cotlearn import diagnostics, plots
from cotlearn.couplings import Independent, MinibatchOT


def point(name, coupling, skew=0.1, variance=1.0, width=0.02, flagged=False):
    found = {"skew": skew, "one_step_variance": variance}
    intervals = {f"{key}_interval": (value - width, value + width) for key, value in found.items()}
    known = {"name": name, "coupling": coupling, "flagged": flagged}
    return SimpleNamespace(**known, **found, **intervals)


CROWDED = [
    point("independent", "independent", 0.001, 4.0),
    point("naive OT", "minibatch_ot", 0.48, 0.1),
    *(point(f"COT x {10**k}", "conditional_ot", 0.2 / 10**k, 0.4 + k / 10) for k in range(5)),
    point("adaptive", "adaptive", 0.001, 0.9),
    point("stratified", "stratified", 0.002, 0.7),
]


def test_frontier_draws_each_coupling_once_with_its_intervals():
    ax = plots.frontier(CROWDED, errors={"naive OT": 1.234}, labels={"adaptive": "C2OT"})
    assert len(ax.get_lines()[0].get_xdata()) == 0  # no curve was asked for
    signs = {look.marker for look in plots.LOOKS.values()}
    markers = [line for line in ax.get_lines() if line.get_marker() in signs]
    drawn = {(float(m.get_xdata()[0]), float(m.get_ydata()[0])) for m in markers}
    assert drawn == {(p.skew, p.one_step_variance) for p in CROWDED}
    colours = {to_hex(m.get_color()).upper() for m in markers}
    assert colours == {plots.COLORS[p.coupling].upper() for p in CROWDED}
    words = {text.get_text() for text in ax.texts}
    assert words >= {"naive OT\nerror 1.2", "C2OT", "independent"}
    bars = [artist for artist in ax.collections if isinstance(artist, LineCollection)]
    assert len(bars) == 2 * len(CROWDED)
    assert np.allclose(bars[0].get_segments()[0][:, 0], CROWDED[0].skew_interval)
    assert ax.get_ylim()[0] == 0


@pytest.mark.parametrize("height", [None, 20])
def test_frontier_labels_do_not_overlap(height):
    _, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    if height:
        ax.set_ylim(0, height)
    plots.frontier(CROWDED, errors={p.name: 0.5 for p in CROWDED}, ax=ax)
    ax.figure.canvas.draw()
    boxes = [Text.get_window_extent(text) for text in ax.texts]
    assert len(boxes) == len(CROWDED)
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert ax.get_window_extent().x0 <= box.x0 <= box.x1 <= ax.get_window_extent().x1 + 1


def test_frontier_draws_skewed_points_hollow():
    ax = plots.frontier([*CROWDED, point("w", "residual", 0.3, 1.0, flagged=True)])
    fills = {m.get_marker(): to_hex(m.get_markerfacecolor()) for m in ax.get_lines()}
    assert fills[plots.LOOKS["residual"].marker] == "#ffffff"
    assert fills["s"] == plots.COLORS["minibatch_ot"].lower()
    assert "hollow" in ax.get_xlabel()


def test_frontier_joins_the_names_of_a_curve_in_their_order():
    ax = plots.frontier(CROWDED, curve=["COT x 10", "COT x 1", "naive OT"])
    assert np.allclose(ax.get_lines()[0].get_xdata(), [0.02, 0.2, 0.48])


def test_frontier_takes_what_the_diagnostics_return_and_uses_the_given_axes():
    g = torch.Generator().manual_seed(0)
    x, c = torch.randn(400, 2, generator=g), torch.eye(2)[torch.arange(400) % 2]
    couplings = {"a": Independent(), "b": MinibatchOT()}
    found = diagnostics.frontier(x, c, couplings, rows=512, progress=False)
    _, ax = plt.subplots()
    assert plots.frontier(found, ax=ax, title="here") is ax
    assert ax.get_title(loc="left") == "here"
    assert {text.get_text() for text in ax.texts} == {"a", "b"}
