"""Pairs and skew."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes

from cotlearn import plots

POINTS = torch.zeros(4, 2)


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


BAD_CALLS = {
    "x1 has 3 rows": lambda: plots.pair_lines(POINTS, POINTS[:3]),
    "c is None": lambda: plots.paired_source(POINTS, None),
    "c must be discrete": lambda: plots.source_given_condition(POINTS, POINTS[:, :1]),
    "labels has": lambda: plots.source_given_condition(POINTS, torch.eye(4), labels=["a"]),
    "axes has": lambda: plots.source_given_condition(POINTS, torch.eye(4), axes=[None]),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
