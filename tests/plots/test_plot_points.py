"""Samples in the plane and panels."""

from __future__ import annotations

import matplotlib.pyplot as plt
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


def test_shared_panels_are_labelled_on_the_outside_only(cloud):
    _, axes = plots.panels(2, shared=True)
    for ax in axes:
        plots.scatter(cloud[0], ax=ax, limit=4)
    assert [bool(ax.get_ylabel()) for ax in axes] == [True, False]


def test_panels():
    figure, axes = plots.panels(5, columns=3)
    assert len(axes) == 5
    assert len(figure.axes) == 5


BAD_CALLS = {
    "x": lambda: plots.scatter(torch.zeros(4, 3)),
    "x has": lambda: plots.scatter(torch.zeros(4)),
    "x is None": lambda: plots.scatter(None),
    "x is not": lambda: plots.scatter("points"),
    "c has shape (3, 2)": lambda: plots.scatter(POINTS, torch.eye(3)[:, :2]),
    "one-hot": lambda: plots.scatter(POINTS, torch.randn(4, 2)),
    "negative": lambda: plots.scatter(POINTS, torch.tensor([-1, 0, 1, 2])),
    "x0": lambda: plots.scatter(POINTS, x0=torch.zeros(4, 1)),
    "n and columns": lambda: plots.panels(0),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
