"""Samples in the plane, pairs, paths and panels."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from matplotlib.colors import to_hex

from cotlearn import plots

POINTS = torch.zeros(4, 2)


@pytest.mark.parametrize("as_numpy", [False, True])
@pytest.mark.parametrize("kind", ["none", "one-hot", "classes", "continuous", "vector"])
def test_scatter_takes_every_form_of_condition(cloud, kind, as_numpy):
    x, _, one_hot = cloud
    known = {"none": None, "one-hot": one_hot, "classes": one_hot.argmax(1)}
    c = {**known, "continuous": x[:, :1], "vector": x[:, 0]}[kind]
    if as_numpy:
        x, c = x.numpy(), None if c is None else c.numpy()
    ax = plots.scatter(x, c, legend=True)
    assert sum(len(artist.get_offsets()) for artist in ax.collections) == 60
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


def test_shared_panels_are_labelled_on_the_outside_only(cloud):
    _, axes = plots.panels(2, shared=True)
    for ax in axes:
        plots.scatter(cloud[0], ax=ax, limit=4)
    assert [bool(ax.get_ylabel()) for ax in axes] == [True, False]


def test_panels():
    figure, axes = plots.panels(5, columns=3)
    assert len(axes) == len(figure.axes) == 5


def test_pair_lines_join_the_partners(cloud):
    x0, x1, c = cloud
    for condition in (None, c, x0[:, :1]):
        ax = plots.pair_lines(x0, x1, condition)
        lines = ax.collections[-1].get_segments()
        assert np.allclose(lines[5], torch.stack([x0[5], x1[5]]).numpy())


def test_paired_source_and_source_given_condition(cloud):
    x0, _, c = cloud
    for condition in (c, x0[:, :1]):
        assert isinstance(plots.paired_source(x0, condition, legend=True), Axes)
    axes = plots.source_given_condition(x0, c, title="naive", labels=["a", "b", "c"])
    assert [len(ax.collections[1].get_offsets()) for ax in axes] == [20, 20, 20]


def test_trajectories_draw_one_path_a_sample(cloud):
    path = torch.stack([cloud[0], cloud[1], cloud[1] + 1])
    lines = plots.trajectories(path, cloud[2]).collections[-1].get_segments()
    assert len(lines) == 60
    assert np.allclose(lines[7], path[:, 7].numpy())


@pytest.mark.parametrize(
    ("draw", "arguments", "words"),
    [
        (plots.scatter, [torch.zeros(4, 3)], r"expected an array of shape \(n, 2\), got \(4, 3\)"),
        (plots.scatter, [POINTS, torch.eye(3)], "c has shape .* one row for each of 4 points"),
        (plots.scatter, [POINTS, torch.randn(4, 2)], "not one-hot"),
        (plots.trajectories, [POINTS], r"shape \(times, n, 2\), got \(4, 2\)"),
        (plots.source_given_condition, [POINTS, POINTS[:, :1]], "c must be discrete"),
    ],
)
def test_shapes_that_would_draw_something_else_are_refused(draw, arguments, words):
    with pytest.raises(ValueError, match=words):
        draw(*arguments)
