"""Small images."""

import numpy as np
import pytest
import torch

from cotlearn import plots


def test_image_grid_places_each_image():
    images = torch.full((12, 64), -1.0)
    images[11] = 1.0
    ax = plots.image_grid(images, row_labels=["first", "second"])
    canvas = ax.images[0].get_array()
    assert canvas.shape == (17, 89)
    assert canvas[9:17, 9:17].max() == 0
    assert (canvas == 0).sum() == 64


def test_pictures_in_colour():
    pictures = np.zeros((5, 4, 6, 3), dtype=np.uint8)
    pictures[3] = (10, 20, 30)
    ax = plots.picture_grid(pictures, columns=3, row_labels=["a", "b"])
    canvas = ax.images[0].get_array()
    assert canvas.shape == (2 * 5 - 1, 3 * 7 - 1, 3)
    assert (canvas[5:, :6] == (10, 20, 30)).all()
    assert (canvas[5:, 14:] == 255).all()  # there is no sixth
    assert [label.get_text() for label in ax.get_yticklabels()] == ["a", "b"]


def test_images_of_another_size_are_refused():
    with pytest.raises(ValueError, match=r"\(n, 64\), got \(3, 63\)"):
        plots.image_grid(torch.zeros(3, 63), row_labels=["a"])
    with pytest.raises(ValueError, match=r"\(n, height, width, 3\), got \(3, 4, 4\)"):
        plots.picture_grid(np.zeros((3, 4, 4)), columns=3, row_labels=["a"])
