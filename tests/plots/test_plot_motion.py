"""Animations and films."""

import io

import numpy as np
import pytest
import torch
from PIL import Image

from cotlearn import plots
from cotlearn.plots.motion import Gif


@pytest.mark.slow
def test_animation_is_a_small_gif(cloud):
    path = torch.stack([cloud[0] + t * (cloud[1] - cloud[0]) for t in torch.linspace(0, 1, 5)])
    animation = plots.animate({"independent": path, "conditional_ot": path}, cloud[2], limit=4)
    picture = plots.gif(animation)
    assert picture.data[:6] in (b"GIF87a", b"GIF89a")
    assert len(picture.data) < 1_000_000


def test_a_gif_has_an_alternative_text():
    assert 'alt="animation"' in Gif(b"")._repr_mimebundle_()["text/html"]


def test_a_film_of_pictures():
    images = np.random.default_rng(0).integers(0, 255, (3, 20, 30, 3), dtype=np.uint8)
    with Image.open(io.BytesIO(plots.film(list(images)).data)) as shown:
        assert (shown.format, shown.n_frames) == ("GIF", 3)


def test_a_film_keeps_the_colour_of_a_small_thing():
    rng = np.random.default_rng(0)
    image = rng.integers(120, 200, (180, 240, 3), dtype=np.uint8)
    image[50:54, 60:64] = (60, 200, 100)
    with Image.open(io.BytesIO(plots.film([image]).data)) as shown:
        found = np.array(shown.convert("RGB"))[51, 61].astype(int)
    assert np.abs(found - (60, 200, 100)).max() < 20
