"""The arm's paths, and the arm itself."""

import numpy as np
import pytest
from matplotlib.collections import LineCollection

from cotlearn import plots
from cotlearn.robots.arm import MODES, random_start, skeleton, solve

STATE = random_start(np.random.default_rng(0), "ring")
AVOID = random_start(np.random.default_rng(0), "avoid")


def paths(n=5, state=STATE):
    share = np.linspace(0, 1, 12)[:, None]
    line = state[:3] + share * (state[3:6] - state[:3])
    return line + 0.02 * np.arange(n)[:, None, None] * np.sin(np.pi * share)


def test_paths_from_above_show_pillars_goal_and_modes():
    lines = paths()
    ax = plots.arm_paths(lines, STATE, modes=[0, 0, 2, -1, 1], title="ring")
    pillar, goal = ax.patches
    assert tuple(pillar.center) == tuple(STATE[6:8])
    assert pillar.radius == STATE[8]
    assert tuple(goal.center) == tuple(STATE[3:5])
    failed, left, right, over, crosses, starts = ax.collections
    assert [len(part.get_segments()) for part in (failed, left, right, over)] == [1, 2, 1, 1]
    assert np.allclose(over.get_segments()[0], lines[2, :, :2])
    assert failed.get_linestyle() != left.get_linestyle()
    assert np.allclose(crosses.get_offsets(), lines[3, -1:, :2])
    assert np.allclose(starts.get_offsets(), lines[:, 0, :2])


def test_twelve_modes_can_be_told_apart():
    ax = plots.arm_paths(paths(12, AVOID), AVOID, modes=np.arange(12))
    assert len(ax.patches) == 6
    lines = [part for part in ax.collections if isinstance(part, LineCollection)]
    assert len({(tuple(part.get_color()[0]), str(part.get_linestyle())) for part in lines}) == 12


def test_paths_in_space():
    ax = plots.arm_paths_3d(paths(), STATE, modes=[0, 0, 2, -1, 1], labels=MODES["ring"])
    assert ax.name == "3d"
    assert ax.get_zlim()[0] == 0 < STATE[9] < ax.get_zlim()[1]
    names = [text.get_text() for text in ax.get_legend().get_texts()]
    assert names == ["failed", "left", "right", "over"]
    ax.figure.canvas.draw()


def test_the_arm_stands_on_the_table_and_its_tip_is_where_it_is():
    points = skeleton(solve(STATE[None, :3]).joints)[0]
    ax = plots.arm_pose(points, STATE, title="arm")
    assert np.allclose(points[0], 0)
    assert np.allclose(points[-1], STATE[:3], atol=1e-4)
    assert np.allclose(np.array(ax.lines[-1].get_data_3d()).T, points[-2:])
    ax.figure.canvas.draw()


def test_shapes_that_would_draw_something_else_are_refused():
    with pytest.raises(ValueError, match=r"shape \(n, T, 3\), got \(5, 12, 7\)"):
        plots.arm_paths(np.zeros((5, 12, 7)), STATE, modes=np.zeros(5))
    with pytest.raises(ValueError, match=r"shape \(5\), got \(1,\)"):
        plots.arm_paths(paths(), STATE, modes=[0])
    with pytest.raises(ValueError, match=r"shape \(10, 3\), got \(9, 3\)"):
        plots.arm_pose(np.zeros((9, 3)), STATE)
