"""Push-T from above."""

import numpy as np
import pytest
from matplotlib.patches import Circle

from cotlearn import plots
from cotlearn.plots.push_t import push_t_state
from cotlearn.robots.push_t import GOAL, corners
from cotlearn.robots.push_t.constants import AGENT_RADIUS

STATE = np.array([100.0, 150.0, 300.0, 200.0, 0.5])
STATES = np.linspace(STATE, [200, 250, *GOAL], 9)


def test_a_state_shows_goal_tee_and_agent_where_they_are():
    ax = push_t_state(STATE, title="start")
    goal, tee, agent = ax.patches
    assert np.allclose(goal.get_xy()[:-1], corners(np.array(GOAL)))
    assert np.allclose(tee.get_xy()[:-1], corners(STATE[2:]))
    assert isinstance(agent, Circle)
    assert tuple(agent.center) == (100, 150)
    assert agent.radius == AGENT_RADIUS
    assert ax.get_ylim() == (512, 0), "y points down, as in the environment's pictures"


def test_an_episode_shows_the_path_and_the_first_and_last_tee():
    ax = plots.push_t_episode(STATES)
    path = ax.collections[0].get_segments()
    assert len(path) == 8
    assert np.allclose([path[0][0], path[-1][1]], STATES[[0, -1], :2])
    tees = ax.patches[1:7]
    assert np.allclose(tees[0].get_xy()[:-1], corners(STATES[0, 2:]))
    assert np.allclose(tees[-1].get_xy()[:-1], corners(STATES[-1, 2:]))
    assert tees[0].get_alpha() < tees[-1].get_alpha() == 1


def test_chunks_begin_at_the_agent():
    chunks = np.random.default_rng(0).uniform(0, 512, (5, 16, 2))
    lines, dots = plots.push_t_chunks(STATE, chunks).collections
    assert len(lines.get_segments()) == 5
    assert all(np.allclose(line[0], STATE[:2]) for line in lines.get_segments())
    assert np.allclose(dots.get_offsets(), chunks[:, -1])


def test_the_animation_is_small_and_ends_at_the_last_state():
    animation = plots.push_t_animation({"a": STATES, "b": STATES[:4]}, every=3, panel=2.2)
    assert animation._save_count == 4
    animation._func(3)
    (*_, tee, disc), (*_, tee_b, _) = (ax.patches for ax in animation._fig.axes)
    assert np.allclose(tee.get_xy()[:-1], corners(STATES[-1, 2:]))
    assert tuple(disc.center) == tuple(STATES[-1, :2])
    assert np.allclose(tee_b.get_xy()[:-1], corners(STATES[3, 2:]))
    assert len(plots.gif(animation).data) < 200_000


def test_a_shape_that_is_none_of_push_t_is_refused():
    with pytest.raises(ValueError, match=r"shape \(5\), got \(4,\)"):
        push_t_state([1, 2, 3, 4])
