import math

import numpy as np
import pytest
import torch

from cotlearn.robots.push_t import GOAL, coverage
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.push_t.constants import AGENT_RADIUS, AREA, SIZE
from cotlearn.robots.push_t.rasteriser import AGENT, BLOCK, OUTLINE, WHITE, rasterise


def _shares(pictures, *colours):
    """The areas that colours have in each picture, in the unit of the world: a linear unmixing."""
    mixing = torch.tensor(colours, dtype=torch.float64).T
    mixing = torch.cat([mixing, torch.ones(1, len(colours), dtype=torch.float64)])
    seen = torch.cat([pictures.double(), torch.ones(*pictures.shape[:3], 1)], dim=3)
    return (seen @ torch.linalg.pinv(mixing).T).sum(dim=(1, 2))


@pytest.mark.parametrize(("size", "within"), [(32, 0.15), (96, 0.03), (384, 0.01)])
def test_shapes_have_their_areas(size, within):
    angle = np.linspace(-2.6, 2.6, 25)
    x, y = 380 + 7 * np.cos(angle), 125 + 5 * np.sin(angle)  # beside the goal
    agent = np.array([[100.0, 400.0]]) + np.random.default_rng(0).uniform(-9, 9, (25, 2))
    pictures = rasterise(np.column_stack([agent, x, y, angle]), size=size)
    pixel = (SIZE / size) ** 2
    top = pictures[:, : size // 2, size // 2 :]
    inner = _shares(top[:, size // 64 + 1 :, : -size // 64 - 1], WHITE, BLOCK)[:, 1] * pixel
    assert inner.numpy() == pytest.approx(AREA, rel=within)
    bottom = pictures[:, size * 5 // 8 : size * 15 // 16, size // 16 : size // 3]
    disc = _shares(bottom, WHITE, AGENT, OUTLINE)[:, 1] * pixel
    assert disc.numpy() == pytest.approx(math.pi * AGENT_RADIUS**2, rel=within)


def test_what_is_left_of_the_goal_is_what_the_coverage_says():
    rng = np.random.default_rng(0)
    pose = np.array(GOAL) + rng.normal(0, [20, 20, 0.3], (40, 3))
    pictures = rasterise(np.column_stack([np.full((40, 2), 60.0), pose]), size=256)
    middle = pictures[:, 50:230, 50:230]
    left = _shares(middle, WHITE, BLOCK, OUTLINE)[:, 2] * (SIZE / 256) ** 2
    assert (1 - left / AREA).numpy() == pytest.approx(coverage(pose), abs=0.02)


def test_pictures_depend_on_the_state_alone():
    rng = np.random.default_rng(1)
    states = np.column_stack([rng.uniform(50, 450, (9, 4)), rng.uniform(-3, 3, 9)])
    pictures = rasterise(states, size=48)
    assert pictures.shape == (9, 48, 48, 3)
    assert pictures.dtype == torch.uint8
    for i, state in enumerate(states):
        assert torch.equal(rasterise(state[None], size=48)[0], pictures[i])
    turned = states + np.array([0, 0, 0, 0, 2 * np.pi])
    assert (rasterise(turned, size=48).int() - pictures.int()).abs().max() <= 1
    assert torch.equal(rasterise(torch.tensor(states), size=48), pictures)
    assert rasterise(np.empty((0, 5)), size=8).shape == (0, 8, 8, 3)


def test_a_tenth_of_a_pixel_shows():
    state = np.array([[100, 100, 300, 300, 0.3]])
    step = 0.1 * SIZE / 48
    for column in range(4):
        moved = state.copy()
        moved[0, column] += step
        assert (rasterise(moved, size=48) != rasterise(state, size=48)).sum() >= 10


# --- the camera ------------------------------------------------------------------------------


@pytest.fixture
def camera():
    return Camera(16, 2, (0, 0, 0, 0, -1, -1), (512, 512, 512, 512, 1, 1))


def _scene(*states):
    rows = [[*(np.array(s[:4]) / 256 - 1), math.cos(s[4]), math.sin(s[4])] for s in states]
    return torch.tensor(np.concatenate(rows)[None], dtype=torch.float32)


def test_a_camera_shows_the_last_picture_and_all_places_of_the_hand(camera):
    before, now = (90, 80, 300, 300, 1.0), (100, 80, 310, 300, 1.1)
    seen = camera(_scene(before, now))
    assert seen.shape == (1, 16 * 16 * 3 + 4)
    picture = rasterise([now], size=16).flatten().float() / 255
    assert (seen[0, :-4] - picture).abs().max() <= 1 / 255
    assert seen[0, -4:].numpy() == pytest.approx(np.array([90, 80, 100, 80]) / 256 - 1, abs=1e-6)


def test_a_camera_never_shows_the_pose_of_the_t(camera):
    """Where the T was, and a T outside the picture, make no difference."""
    now = (100, 80, 310, 300, 1.1)
    seen = camera(_scene((90, 80, 300, 300, 1.0), now))
    assert torch.equal(camera(_scene((90, 80, 111, 222, -1.0), now)), seen)
    outside = camera(_scene(now, (100, 80, 3000, 300, 1.1)))
    assert torch.equal(camera(_scene(now, (100, 80, 300, -3000, 2.0))), outside)
