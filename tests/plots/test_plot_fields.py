"""Velocities, contours, nets and outlines."""

import numpy as np
import torch

from cotlearn import plots

ACROSS, UP = torch.linspace(-2, 2, 9), torch.linspace(-1, 1, 5)
HEIGHT = ACROSS.square()[None] + UP[:, None]


def test_contours_show_the_function_the_right_way_round():
    ax = plots.contours(ACROSS, UP, HEIGHT, title="a valley")
    lines = ax.collections[-1]
    low, high = lines.get_datalim(ax.transData).get_points()
    assert np.allclose([low, high], [(-2, -1), (2, 1)], atol=0.3)
    assert ax.get_title(loc="left") + ax.get_title() == "a valley"


def test_a_net_has_a_thread_for_each_row_and_column():
    knots = torch.stack(torch.meshgrid(ACROSS, UP, indexing="ij"), dim=2)
    ax = plots.net(knots, limit=3)
    threads = ax.collections[0].get_segments()
    assert len(threads) == 9 + 5
    assert np.allclose(threads[0], knots[0].numpy())
    assert np.allclose(threads[9], knots[:, 0].numpy())
    assert ax.get_xlim() == (-3, 3)


def test_outlines_are_closed_and_coloured_by_condition():
    circle = torch.randn(20, 3, 2, generator=torch.Generator().manual_seed(0))
    ax = plots.outlines(circle, torch.tensor([[-1.0], [0.0], [1.0]]), truth=circle[::2])
    drawn, true = ax.collections
    assert len(drawn.get_segments()) == len(true.get_segments()) == 3
    assert all(np.allclose(curve[0], curve[-1]) for curve in drawn.get_segments())
    assert len(np.unique(drawn.get_color(), axis=0)) == 3


def test_velocity_field(cloud):
    assert plots.velocity_field(cloud[0], cloud[1], limit=3).get_xlabel()
