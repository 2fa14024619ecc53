"""Small images."""

from __future__ import annotations

import pytest
import torch

from cotlearn import plots


def test_image_grid_places_each_image():
    images = torch.full((12, 64), -1.0)
    images[11] = 1.0
    ax = plots.image_grid(images, columns=10, row_labels=["first", "second"])
    canvas = ax.images[0].get_array()
    assert canvas.shape == (17, 89)
    assert canvas[9:17, 9:17].min() == 1.0
    assert (canvas == 1.0).sum() == 64


BAD_CALLS = {
    "images has": lambda: plots.image_grid(torch.zeros(3, 63)),
    "columns is": lambda: plots.image_grid(torch.zeros(3, 64), columns=0),
    "row_labels has": lambda: plots.image_grid(torch.zeros(3, 64), row_labels=["a", "b"]),
}


@pytest.mark.parametrize("words", BAD_CALLS)
def test_what_does_not_fit_is_refused_by_name(words):
    with pytest.raises(ValueError) as caught:
        BAD_CALLS[words]()
    assert words in str(caught.value)
