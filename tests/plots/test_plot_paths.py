"""Paths and velocities."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cotlearn import plots

POINTS = torch.zeros(4, 2)


def test_trajectories_draw_one_path_a_sample(cloud):
    path = torch.stack([cloud[0], cloud[1], cloud[1] + 1])
    ax = plots.trajectories(path, cloud[2])
    assert len(ax.collections[0].get_segments()) == 60
    assert np.allclose(ax.collections[0].get_segments()[7], path[:, 7].numpy())


def test_velocity_field(cloud):
    ax = plots.velocity_field(cloud[0], cloud[1], limit=3)
    assert ax.get_xlabel()


BAD_CALLS = {
    "path": lambda: plots.trajectories(POINTS),
    "times >= 2": lambda: plots.trajectories(POINTS[None]),
    "velocity has": lambda: plots.velocity_field(POINTS, POINTS[:2]),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
