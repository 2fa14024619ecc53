import numpy as np
import pytest

from cotlearn.robots.arm import GoalFrame, random_start
from cotlearn.robots.arm.constants import GOAL, KINDS, TIP, columns


def histories(kind, n=20):
    rng = np.random.default_rng(0)
    state = np.array([random_start(np.random.default_rng(seed), kind) for seed in range(n)])
    history = np.repeat(state[:, None], 3, axis=1)
    history[:, :, TIP] += rng.normal(0, 0.05, (n, 3, 3))
    return history


def turned(values, angle, about, kind):
    """States, or points, turned about the vertical line through `about`."""
    cos, sin = np.cos(angle), np.sin(angle)
    matrix = np.array([[cos, sin], [-sin, cos]])
    result = values.copy()
    width = values.shape[-1]
    for first in (0,) if width == 3 else (0, 3, *range(6, width, 4)):
        place = slice(first, first + 2)
        result[..., place] = (values[..., place] - about) @ matrix + about
    return result


@pytest.mark.parametrize("kind", KINDS)
def test_from_frame_is_the_inverse_of_to_frame_and_distances_stay(kind):
    frame, history = GoalFrame(kind), histories(kind)
    actions = np.random.default_rng(1).uniform(-1, 1, (len(history), 7, 3))
    seen = frame.to_frame(actions, history)
    assert np.abs(frame.from_frame(seen, history) - actions).max() < 1e-14
    assert np.allclose(np.diff(seen, axis=1)[..., 2], np.diff(actions, axis=1)[..., 2])
    lengths = [np.linalg.norm(np.diff(a, axis=1), axis=-1) for a in (seen, actions)]
    assert np.allclose(*lengths)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_seen(kind):
    frame, history = GoalFrame(kind), histories(kind)
    seen = frame.observe(history)
    assert seen.shape == (*history.shape[:2], frame.features)
    assert frame.features == len(columns(kind))
    assert np.abs(seen[:, -1, :2]).max() < 1e-15  # the tip is the origin
    assert np.abs(seen[:, -1, 4]).max() < 0.04  # the goal is ahead, almost
    assert (seen[:, -1, 3] > 0).all()
    away = np.linalg.norm(history[:, -1, GOAL][:, :2] - history[:, -1, TIP][:, :2], axis=1)
    assert np.allclose(np.hypot(seen[:, -1, 3], seen[:, -1, 4]), away)
    for untouched in (2, 5, 8, 9):
        assert np.array_equal(seen[..., untouched], history[..., untouched])
    goal = frame.to_frame(history[:, -1:, GOAL], history)[:, 0]
    assert np.allclose(goal[:, :2], seen[:, -1, 3:5])
    assert np.allclose(goal[:, 2], history[:, -1, 5] - history[:, -1, 2])


@pytest.mark.parametrize("kind", KINDS)
def test_a_turned_and_moved_world_looks_the_same(kind):
    frame, history = GoalFrame(kind), histories(kind)
    actions = np.random.default_rng(1).uniform(-1, 1, (len(history), 4, 3))
    about = np.array([0.3, -0.2])
    again, moved = (turned(values, 1.1, about, kind) for values in (history, actions))
    assert np.allclose(frame.observe(again), frame.observe(history))
    assert np.allclose(frame.to_frame(moved, again), frame.to_frame(actions, history))


@pytest.mark.parametrize("kind", KINDS)
def test_at_the_goal_itself_the_frame_is_still_one(kind):
    frame, history = GoalFrame(kind), histories(kind)
    history[:, -1, TIP] = history[:, -1, GOAL]
    actions = np.random.default_rng(1).uniform(-1, 1, (len(history), 4, 3))
    back = frame.from_frame(frame.to_frame(actions, history), history)
    assert np.abs(back - actions).max() < 1e-14
    assert np.isfinite(frame.observe(history)).all()


def test_nothing_is_changed():
    frame, history = GoalFrame("ring"), histories("ring")
    before = history.copy()
    frame.observe(history)
    frame.from_frame(frame.to_frame(np.zeros((len(history), 2, 3)), history), history)
    assert np.array_equal(history, before)
