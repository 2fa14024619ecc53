"""The arm's paths, and the arm itself."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from cotlearn import plots
from cotlearn.robots.arm import WAYS, random_start, skeleton, solve

STATE = random_start(np.random.default_rng(0), "ring")
AVOID = random_start(np.random.default_rng(0), "avoid")


def paths(n=5, state=STATE):
    share = np.linspace(0, 1, 12)[:, None]
    line = state[:3] + share * (state[3:6] - state[:3])
    return line + 0.02 * np.arange(n)[:, None, None] * np.sin(np.pi * share)


def test_paths_from_above_show_pillars_goal_and_ways():
    lines = paths()
    ax = plots.arm_paths(lines, STATE, modes=[0, 0, 2, -1, 1], labels=WAYS["ring"], title="ring")
    pillar, goal = ax.patches
    assert tuple(pillar.center) == tuple(STATE[6:8])
    assert pillar.radius == STATE[8]
    assert tuple(goal.center) == tuple(STATE[3:5])
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["failed", "left", "right", "over"]
    drawn = {part.get_label(): part for part in ax.collections}
    assert len(drawn["left"].get_segments()) == 2
    assert np.allclose(drawn["over"].get_segments()[0], lines[2, :, :2])
    assert drawn["failed"].get_linestyle() != drawn["left"].get_linestyle()


def test_many_ways_can_be_told_apart():
    lines = paths(12, AVOID)
    ax = plots.arm_paths(lines, AVOID, modes=np.arange(12), labels=WAYS["avoid"])
    assert len(ax.patches) == 6
    looks = {
        (tuple(part.get_color()[0]), str(part.get_linestyle()))
        for part in ax.collections
        if part.get_label() in WAYS["avoid"]
    }
    assert len(looks) == 12


def test_without_modes_all_paths_are_alike_and_there_is_no_legend():
    ax = plots.arm_paths(paths(), STATE)
    assert ax.get_legend() is None
    assert len(ax.collections[0].get_segments()) == 5


def test_paths_in_space():
    ax = plots.arm_paths_3d(paths(), STATE, modes=[0, 0, 2, -1, 1], labels=WAYS["ring"])
    assert ax.name == "3d"
    assert ax.get_zlim()[0] == 0
    assert ax.get_zlim()[1] > STATE[9]
    assert len(ax.get_legend().get_texts()) == 4
    ax.figure.canvas.draw()


def test_the_arm_stands_on_the_table_and_its_tip_is_where_it_is():
    points = skeleton(solve(STATE[None, :3]).joints)[0]
    ax = plots.arm_pose(points, STATE, title="arm")
    assert np.allclose(points[0], 0)
    assert np.allclose(points[-1], STATE[:3], atol=1e-4)
    tool = np.array(ax.lines[-1].get_data_3d()).T
    assert np.allclose(tool, points[-2:])
    ax.figure.canvas.draw()


def test_a_film_of_pictures():
    images = np.random.default_rng(0).integers(0, 255, (3, 20, 30, 3), dtype=np.uint8)
    assert plots.film(list(images)).data[:3] == b"GIF"
    with pytest.raises(ValueError, match="images must be uint8 arrays"):
        plots.film([])


def test_a_film_keeps_the_colour_of_a_small_thing():
    rng = np.random.default_rng(0)
    image = rng.integers(120, 200, (180, 240, 3), dtype=np.uint8)
    image[50:54, 60:64] = (60, 200, 100)
    with Image.open(io.BytesIO(plots.film([image], colors=64).data)) as shown:
        found = np.array(shown.convert("RGB"))[51, 61].astype(int)
    assert np.abs(found - (60, 200, 100)).max() < 20


BAD_CALLS = {
    r"paths must be finite of shape \(n, T, 3\)": lambda: plots.arm_paths(paths()[0], STATE),
    "paths must be finite": lambda: plots.arm_paths_3d(paths() * np.nan, STATE),
    r"modes must have shape \(5,\)": lambda: plots.arm_paths(paths(), STATE, modes=[0]),
    "state must be finite of shape": lambda: plots.arm_paths(paths(), STATE[:8]),
    r"points must be finite of shape \(10, 3\)": lambda: plots.arm_pose(np.zeros((9, 3)), STATE),
}


@pytest.mark.parametrize("message", BAD_CALLS)
def test_bad_calls(message):
    with pytest.raises(ValueError, match=message):
        BAD_CALLS[message]()
