"""Animations."""

from __future__ import annotations

import pytest
import torch

from cotlearn import plots

POINTS = torch.zeros(4, 2)


def test_animation_is_a_small_gif(cloud):
    path = torch.stack([cloud[0] + t * (cloud[1] - cloud[0]) for t in torch.linspace(0, 1, 5)])
    for c in (None, cloud[2], cloud[0][:, :1]):
        animation = plots.animate({"independent": path, "conditional_ot": path}, c, limit=4, hold=1)
        picture = plots.gif(animation)
        assert picture.data[:6] in (b"GIF87a", b"GIF89a")
        assert len(picture.data) < 1_000_000


BAD_CALLS = {
    "paths is empty": lambda: plots.animate({}, limit=1),
    "paths have different": lambda: plots.animate(
        {"a": POINTS.expand(2, 4, 2), "b": POINTS.expand(3, 4, 2)}, limit=1
    ),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
