"""Each figure accepts what it promises, draws what it is given, and refuses what does not fit."""

from __future__ import annotations

from types import SimpleNamespace

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex, to_rgb
from matplotlib.text import Text

from cotlearn import diagnostics, plots
from cotlearn.couplings import Independent, MinibatchOT

COUPLING_NAMES = {
    "independent",
    "minibatch_ot",
    "conditional_ot",
    "adaptive",
    "stratified",
    "semidiscrete",
    "aligned",
    "reflow",
    "truth",
}


@pytest.fixture(autouse=True)
def close_figures():
    with plt.rc_context():
        plots.use_style()
        yield
    plt.close("all")


@pytest.fixture
def cloud():
    g = torch.Generator().manual_seed(0)
    x0 = torch.randn(60, 2, generator=g)
    c = torch.eye(3)[torch.arange(60) % 3]
    return x0, 2 * x0 + 1, c


def test_every_coupling_has_one_colour_marker_line_and_label():
    for table in (plots.COLORS, plots.MARKERS, plots.LINESTYLES, plots.LABELS):
        assert set(table) == COUPLING_NAMES
    assert len(set(plots.COLORS.values())) == len(COUPLING_NAMES)
    assert len(set(plots.MARKERS.values())) == len(COUPLING_NAMES)
    assert len({str(v) for v in plots.LINESTYLES.values()}) == len(COUPLING_NAMES)
    assert len(set(plots.CONDITION_COLORS)) == len(plots.CONDITION_MARKERS) == 10


def test_use_style_changes_the_figure():
    plt.rcdefaults()
    plots.use_style()
    assert not plt.rcParams["axes.spines.top"]


@pytest.mark.parametrize("as_numpy", [False, True])
@pytest.mark.parametrize("kind", ["none", "one-hot", "classes", "continuous", "vector"])
def test_scatter_takes_every_form_of_condition(cloud, kind, as_numpy):
    x, _, one_hot = cloud
    c = {
        "none": None,
        "one-hot": one_hot,
        "classes": one_hot.argmax(1),
        "continuous": x[:, :1],
        "vector": x[:, 0],
    }[kind]
    if as_numpy:
        x, c = x.numpy(), None if c is None else c.numpy()
    ax = plots.scatter(x, c, legend=True)
    assert isinstance(ax, Axes)
    drawn = sum(len(artist.get_offsets()) for artist in ax.collections)
    assert drawn == 60
    assert ax.get_xlabel()
    assert ax.get_ylabel()


def test_scatter_uses_the_given_axes_and_limit(cloud):
    _, ax = plt.subplots()
    assert plots.scatter(cloud[0], ax=ax, limit=5.0, title="here") is ax
    assert ax.get_xlim() == (-5.0, 5.0)
    assert ax.get_title(loc="left") == "here"


def test_scatter_colours_follow_the_classes(cloud):
    ax = plots.scatter(cloud[0], cloud[2])
    shown = [to_hex(artist.get_facecolor()[0]).upper() for artist in ax.collections]
    assert shown == [color.upper() for color in plots.CONDITION_COLORS[:3]]


def test_scatter_accepts_gradients_and_inputs_stay(cloud):
    x = cloud[0].clone().requires_grad_()
    before = x.detach().clone()
    plots.scatter(x, cloud[2])
    assert torch.equal(x.detach(), before)


def test_trajectories_draw_one_path_a_sample(cloud):
    path = torch.stack([cloud[0], cloud[1], cloud[1] + 1])
    ax = plots.trajectories(path, cloud[2])
    assert len(ax.collections[0].get_segments()) == 60
    assert np.allclose(ax.collections[0].get_segments()[7], path[:, 7].numpy())


def test_pair_lines_join_the_partners(cloud):
    x0, x1, c = cloud
    for condition in (None, c, x0[:, :1]):
        ax = plots.pair_lines(x0, x1, condition)
        assert np.allclose(ax.collections[0].get_segments()[5], torch.stack([x0[5], x1[5]]).numpy())


def test_paired_source_and_source_given_condition(cloud):
    x0, _, c = cloud
    assert isinstance(plots.paired_source(x0, c, legend=True), Axes)
    assert isinstance(plots.paired_source(x0, x0[:, :1], legend=True), Axes)
    axes = plots.source_given_condition(x0, c, title="naive", labels=["a", "b", "c"])
    assert len(axes) == 3
    assert [len(ax.collections[1].get_offsets()) for ax in axes] == [20, 20, 20]


def test_velocity_field(cloud):
    ax = plots.velocity_field(cloud[0], cloud[1], limit=3)
    assert ax.get_xlabel()


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


def frontier_point(name, coupling, skew=0.1, variance=1.0, width=0.02):
    return SimpleNamespace(
        name=name,
        coupling=coupling,
        skew=skew,
        skew_interval=(skew - width, skew + width),
        one_step_variance=variance,
        one_step_variance_interval=(variance - width, variance + width),
    )


CROWDED = [
    frontier_point("independent", "independent", 0.001, 4.0),
    frontier_point("naive OT", "minibatch_ot", 0.48, 0.1),
    *(
        frontier_point(f"COT x {10**k}", "conditional_ot", 0.2 / 10**k, 0.4 + k / 10)
        for k in range(5)
    ),
    frontier_point("adaptive", "adaptive", 0.001, 0.9),
    frontier_point("stratified", "stratified", 0.002, 0.7),
]


def test_frontier_draws_each_coupling_once_with_its_intervals():
    ax = plots.frontier(CROWDED, errors={"naive OT": 1.234}, labels={"adaptive": "C2OT"})
    assert len(ax.get_lines()[0].get_xdata()) == 0  # no curve was asked for
    markers = [line for line in ax.get_lines() if line.get_marker() in plots.MARKERS.values()]
    drawn = {(float(m.get_xdata()[0]), float(m.get_ydata()[0])) for m in markers}
    assert drawn == {(point.skew, point.one_step_variance) for point in CROWDED}
    colours = {to_hex(m.get_color()).upper() for m in markers}
    assert colours == {plots.COLORS[point.coupling].upper() for point in CROWDED}
    words = {text.get_text() for text in ax.texts}
    assert words >= {"naive OT\nerror 1.2", "C2OT", "independent"}
    bars = [artist for artist in ax.collections if isinstance(artist, LineCollection)]
    assert len(bars) == 2 * len(CROWDED)
    assert np.allclose(bars[0].get_segments()[0][:, 0], CROWDED[0].skew_interval)
    assert ax.get_ylim()[0] == 0


@pytest.mark.parametrize("log", [False, True])
def test_frontier_labels_do_not_overlap(log):
    ax = plots.frontier(CROWDED, errors={p.name: 0.5 for p in CROWDED}, log=log)
    ax.figure.canvas.draw()
    boxes = [Text.get_window_extent(text) for text in ax.texts]
    assert len(boxes) == len(CROWDED)
    for k, box in enumerate(boxes):
        assert not any(box.overlaps(other) for other in boxes[:k])
        assert ax.get_window_extent().x0 <= box.x0 <= box.x1 <= ax.get_window_extent().x1 + 1


def test_frontier_joins_the_names_of_a_curve_in_their_order():
    ax = plots.frontier(CROWDED, curve=["COT x 10", "COT x 1", "naive OT"])
    assert np.allclose(ax.get_lines()[0].get_xdata(), [0.02, 0.2, 0.48])


def test_frontier_takes_what_the_diagnostics_return_and_uses_the_given_axes():
    g = torch.Generator().manual_seed(0)
    x, c = torch.randn(400, 2, generator=g), torch.eye(2)[torch.arange(400) % 2]
    found = diagnostics.frontier(
        x, c, {"a": Independent(), "b": MinibatchOT()}, rows=512, progress=False
    )
    _, ax = plt.subplots()
    assert plots.frontier(found, ax=ax, title="here") is ax
    assert ax.get_title(loc="left") == "here"
    assert {text.get_text() for text in ax.texts} == {"a", "b"}


def test_shared_panels_are_labelled_on_the_outside_only(cloud):
    _, axes = plots.panels(2, shared=True)
    for ax in axes:
        plots.scatter(cloud[0], ax=ax, limit=4)
    assert [bool(ax.get_ylabel()) for ax in axes] == [True, False]


def test_an_unknown_coupling_can_be_drawn():
    ax = plots.error_against_nfe([1, 2], {"my_own": [1.0, 0.5]})
    assert ax.get_legend().get_texts()[0].get_text() == "my_own"


def test_curves_and_training_curves():
    ax = plots.curves([1, 2], {"truth": [3, 4]}, xlabel="g", ylabel="error", log="xy")
    assert ax.get_xscale() == "log"
    history = {"step": np.arange(5), "loss": torch.rand(5)}
    assert len(plots.training_curves({"independent": history}).get_lines()) == 2


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


def test_image_grid_places_each_image():
    images = torch.full((12, 64), -1.0)
    images[11] = 1.0
    ax = plots.image_grid(images, columns=10, row_labels=["first", "second"])
    canvas = ax.images[0].get_array()
    assert canvas.shape == (17, 89)
    assert canvas[9:17, 9:17].min() == 1.0
    assert (canvas == 1.0).sum() == 64


def test_animation_is_a_small_gif(cloud):
    path = torch.stack([cloud[0] + t * (cloud[1] - cloud[0]) for t in torch.linspace(0, 1, 5)])
    for c in (None, cloud[2], cloud[0][:, :1]):
        animation = plots.animate({"independent": path, "conditional_ot": path}, c, limit=4, hold=1)
        picture = plots.gif(animation)
        assert picture.data[:6] in (b"GIF87a", b"GIF89a")
        assert len(picture.data) < 1_000_000


def test_panels():
    figure, axes = plots.panels(5, columns=3)
    assert len(axes) == 5
    assert len(figure.axes) == 5


POINTS = torch.zeros(4, 2)
BAD_CALLS = {
    "x": lambda: plots.scatter(torch.zeros(4, 3)),
    "x has": lambda: plots.scatter(torch.zeros(4)),
    "x is None": lambda: plots.scatter(None),
    "x is not": lambda: plots.scatter("points"),
    "c has shape (3, 2)": lambda: plots.scatter(POINTS, torch.eye(3)[:, :2]),
    "one-hot": lambda: plots.scatter(POINTS, torch.randn(4, 2)),
    "negative": lambda: plots.scatter(POINTS, torch.tensor([-1, 0, 1, 2])),
    "x0": lambda: plots.scatter(POINTS, x0=torch.zeros(4, 1)),
    "path": lambda: plots.trajectories(POINTS),
    "times >= 2": lambda: plots.trajectories(POINTS[None]),
    "x1 has 3 rows": lambda: plots.pair_lines(POINTS, POINTS[:3]),
    "velocity has": lambda: plots.velocity_field(POINTS, POINTS[:2]),
    "c is None": lambda: plots.paired_source(POINTS, None),
    "c must be discrete": lambda: plots.source_given_condition(POINTS, POINTS[:, :1]),
    "labels has": lambda: plots.source_given_condition(POINTS, torch.eye(4), labels=["a"]),
    "axes has": lambda: plots.source_given_condition(POINTS, torch.eye(4), axes=[None]),
    "nfe has": lambda: plots.error_against_nfe([0, 1], {"truth": [1, 1]}),
    "errors['truth'] has": lambda: plots.error_against_nfe([1, 2], {"truth": [1, 1, 1]}),
    "must be finite, and positive": lambda: plots.error_against_nfe([1, 2], {"truth": [1, -1]}),
    "log is": lambda: plots.curves([1], {"truth": [1]}, xlabel="", ylabel="", log="z"),
    "values['truth']": lambda: plots.curves([1], {"truth": [1, 2]}, xlabel="", ylabel=""),
    "step and loss": lambda: plots.training_curves({"truth": {"loss": [1]}}),
    "one length": lambda: plots.training_curves({"truth": {"loss": [1], "step": [1, 2]}}),
    "values must be finite": lambda: plots.bars({"truth": float("nan")}, ylabel=""),
    "intervals has": lambda: plots.bars({"a": 1.0}, intervals={"b": (0, 1)}, ylabel=""),
    "finite (n,)": lambda: plots.histogram({"truth": []}, xlabel=""),
    "values is empty": lambda: plots.histogram({}, xlabel=""),
    "images has": lambda: plots.image_grid(torch.zeros(3, 63)),
    "columns is": lambda: plots.image_grid(torch.zeros(3, 64), columns=0),
    "row_labels has": lambda: plots.image_grid(torch.zeros(3, 64), row_labels=["a", "b"]),
    "points is empty": lambda: plots.frontier([]),
    "errors has ['b']": lambda: plots.frontier([frontier_point("a", "adaptive")], errors={"b": 1}),
    "labels has ['b']": lambda: plots.frontier([frontier_point("a", "x")], labels={"b": "c"}),
    "curve has ['b']": lambda: plots.frontier([frontier_point("a", "adaptive")], curve=["b"]),
    "skew of 'a' must be finite": lambda: plots.frontier([frontier_point("a", "x", float("nan"))]),
    "one_step_variance must be positive": lambda: plots.frontier(
        [frontier_point("a", "x", 0.1, 0.0)], log=True
    ),
    "paths is empty": lambda: plots.animate({}, limit=1),
    "paths have different": lambda: plots.animate(
        {"a": POINTS.expand(2, 4, 2), "b": POINTS.expand(3, 4, 2)}, limit=1
    ),
    "n and columns": lambda: plots.panels(0),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)


def test_colours_are_valid():
    for color in (*plots.COLORS.values(), *plots.CONDITION_COLORS):
        assert len(to_rgb(color)) == 3
