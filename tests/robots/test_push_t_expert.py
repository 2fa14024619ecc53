import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cotlearn.robots.push_t import GOAL, Simulation, corners, random_state
from cotlearn.robots.push_t.expert import PushTExpert, plan, pushes
from cotlearn.robots.push_t.expert.route import (
    CLEAR,
    TURNS,
    Routes,
    clearance,
    distance,
    step_back,
)

near = st.floats(-150, 200)
points = st.tuples(near, near).map(np.array)


@pytest.fixture(scope="module")
def expert():
    return PushTExpert()


def start(seed):
    return random_state(np.random.default_rng(seed))


# --- ways around the T -------------------------------------------------------------------------


@given(points, points)
@settings(deadline=None)
def test_clearance_is_the_least_distance_along_the_way(a, b):
    along = a + np.linspace(0, 1, 2001)[:, None] * (b - a)
    assert clearance(a[None], b[None])[0] == pytest.approx(distance(along).min(), abs=0.3)


def test_distance_of_known_points():
    places = np.array([(0, 10), (0, -5), (70, 15), (30, 60), (18, 124), (63, -4)], dtype=float)
    assert distance(places) == pytest.approx([0, 5, 10, 15, 5, 5])


@given(points)
@settings(deadline=None)
def test_ways_are_clear_and_lead_around_the_tee(agent):
    agent = step_back(agent)
    routes = Routes(np.array([(0.0, -19.0), (45.0, 49.0), (0.0, 139.0)]))
    lengths, found = routes.lengths(agent, np.ones(6, dtype=bool))
    for place, goal in enumerate(routes.places):
        way = np.vstack([agent, routes.way(place, found), goal])
        length = np.hypot(*np.diff(way, axis=0).T).sum()
        assert length == pytest.approx(lengths[place])
        assert length >= np.hypot(*(goal - agent)) - 1e-9
        assert clearance(way[:-1], way[1:]).min() >= CLEAR - 0.01


def test_turning_points_outside_the_world_are_not_used():
    routes = Routes(np.array([(0.0, 139.0)]))
    agent = np.array([0.0, -19.0])
    free, _ = routes.lengths(agent, np.ones(6, dtype=bool))
    right, found = routes.lengths(agent, np.array([False, True, True, True, False, False]))
    assert right == pytest.approx(free)
    assert (routes.way(0, found)[:, 0] > 0).all()
    nowhere, _ = routes.lengths(agent, np.zeros(6, dtype=bool))
    assert np.isinf(nowhere)
    assert len(TURNS) == 6


# --- pushes and their values ------------------------------------------------------------------


@pytest.mark.slow
def test_pushes_do_the_same_wherever_the_tee_is():
    """Also those that were only mirrored, in a T that is turned and elsewhere."""
    library = pushes.library()
    generator = np.random.default_rng(0)
    for row in generator.choice(len(library.steps), 30, replace=False):
        pose = np.array([*generator.uniform(220, 290, 2), generator.uniform(-3, 3)])
        begin = corners(pose, library.start[row][None])[0]
        direction = corners((0, 0, pose[2]), library.direction[row][None])[0]
        world = Simulation([*begin, *pose])
        for target in pushes.push_targets(world, begin, direction, library.length[row]):
            world.step(*target.tolist())
        found = plan.relative_pose(np.array(world.state[2:]))
        expected = plan.after(plan.relative_pose(pose), library)[row]
        assert np.abs(found - expected)[:2].max() < 0.5
        assert abs(math.remainder(found[2] - expected[2], 2 * math.pi)) < 0.01


@pytest.mark.slow
def test_sides_are_those_of_the_start():
    library = pushes.library()
    assert (library.start[library.side == 0][:, 1] < 0).all()
    assert (library.start[library.side == 4][:, 1] > 120).all()
    for right, left in ((1, 7), (2, 6), (3, 5)):
        assert (library.start[library.side == right][:, 0] > 0).all()
        assert (library.start[library.side == left][:, 0] < 0).all()
        assert (library.side == right).sum() == (library.side == left).sum()


@given(st.floats(-200, 200), st.floats(-200, 200), st.floats(-3, 3))
def test_relative_poses_and_back(x, y, angle):
    relative = np.array([x, y, angle])
    pose = plan.world_pose(relative[None])[0]
    assert plan.relative_pose(pose) == pytest.approx(relative, abs=1e-9)


@pytest.mark.slow
def test_the_value_is_zero_at_the_goal_and_grows_away_from_it():
    value = plan.value()
    assert plan.relative_pose(np.array(GOAL)) == pytest.approx([0, 0, 0], abs=1e-12)
    poses = np.array([[0, 0, 0], [20, 0, 0], [120, 0, 0], [120, 120, 3.0]], dtype=float)
    values = value(poses)
    assert values[0] == 0
    assert (np.diff(values) > 5).all()
    assert (value.table >= 0).all()
    assert value(poses * [-1, 1, -1]) == pytest.approx(values, abs=3)


# --- the demonstrator -------------------------------------------------------------------------


@pytest.mark.slow
def test_the_expert_reaches_the_goal(expert):
    episodes = [expert.episode(seed) for seed in range(50_000, 50_012)]
    assert all(episode.success for episode in episodes)
    assert np.median([len(episode.action) for episode in episodes]) < 120
    for episode in episodes:
        assert episode.action.min() >= 0
        assert episode.action.max() <= 512
        assert np.array_equal(episode.action * 32, np.rint(episode.action * 32))
    noise = np.concatenate([episode.action - episode.intention for episode in episodes])
    assert noise.std() == pytest.approx(5, abs=0.3)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_episode(expert):
    first, second = expert.episode(3), expert.episode(3)
    assert np.array_equal(first.action, second.action)
    assert np.array_equal(first.state, second.state)
    assert tuple(first.state[0]) == Simulation(start(3)).state
    assert not np.array_equal(first.action[:5], expert.episode(4).action[:5])


def test_an_episode_can_start_anywhere(expert):
    """Then the seed is of the choices alone."""
    first, second = (expert.episode(seed, state=start(3)) for seed in (1, 2))
    assert tuple(first.state[0]) == tuple(second.state[0]) == Simulation(start(3)).state
    assert not np.array_equal(first.action[:5], second.action[:5])


def test_demonstrations_are_multimodal(expert):
    """From the same state the next push may be on several sides of the T."""
    sides = np.array([expert.first_sides(np.array(start(seed))) for seed in range(60)])
    assert sides.sum(axis=1) == pytest.approx(np.ones(60))
    entropy = -np.sum(sides * np.log(np.maximum(sides, 1e-300)), axis=1)
    assert np.exp(entropy).mean() > 1.3
    assert (sides.max(axis=1) < 0.9).mean() > 0.3


def test_options_are_near_the_best(expert):
    options = expert.options(np.array(start(5)))
    assert len(options.rows) == len(options.cost) == len(options.probability)
    assert options.probability.sum() == pytest.approx(1)
    assert options.cost.max() <= options.cost.min() + 3 * 2 * (1 + 0.25) + 1e-9


def test_the_expert_starts_from_awkward_states(expert):
    """The agent inside the T, or in a corner with the T at the walls."""
    for state in ([256, 256, 256, 256, 0.3], [5, 5, 80, 80, 2.0], [500, 10, 420, 430, -0.5]):
        assert expert.options(np.array(state)).probability.sum() == pytest.approx(1)
