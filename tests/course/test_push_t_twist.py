"""Push-T with another goal and an obstacle."""

import math

import numpy as np
import pytest

from cotlearn.course import push_t_twist
from cotlearn.course.push_t_twist import Twist, covered, play
from cotlearn.robots.push_t import GOAL, coverage

STATES = np.random.default_rng(0).uniform(100, 400, (5, 5))


def test_the_usual_goal_is_covered_as_usual():
    assert np.allclose(covered(STATES, GOAL), coverage(STATES[:, 2:]))


def test_a_t_on_the_new_goal_covers_it():
    goal = (310.0, 180.0, -2.0)
    exact = np.array([[0, 0, *goal], [0, 0, goal[0], goal[1], goal[2] + 2 * math.pi]])
    assert np.allclose(covered(exact, goal), 1)
    assert covered(np.array([[0, 0, 310, 180, -2 + math.pi]]), goal)[0] < 0.6


def test_episodes(monkeypatch):
    asked = []

    def stay(history):
        asked.append(history.shape)
        return np.repeat(history[:, -1:, :2], 4, axis=1)

    twist = Twist(obstacle=(256.0, 256.0, 100.0))
    monkeypatch.setattr(push_t_twist, "EPISODES", 3)
    monkeypatch.setattr(push_t_twist, "MAX_STEPS", 8)
    game = play(stay, twist)
    assert asked == [(3, 2, 5)] * 2
    assert game.path.shape == (9, 3, 5)
    assert (np.hypot(*(game.path[0, :, :2] - 256).T) >= 100).all()
    assert (game.touched == 0).all()
    monkeypatch.setattr(push_t_twist, "MAX_STEPS", 30)
    inside = play(lambda h: np.full((3, 1, 2), 256.0), twist)
    assert (inside.touched > 5).all()
    assert (inside.coverage >= 0).all()


def test_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"act must return shape \(20, n, 2\), got \(20, 2\)"):
        play(lambda h: h[:, 0, :2], Twist())
