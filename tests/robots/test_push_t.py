import math

import gymnasium
import numpy as np
import peers
import push_t_peer
import pytest
from gymnasium.utils import seeding
from gymnasium.utils.env_checker import check_env
from hypothesis import given, settings
from hypothesis import strategies as st

import cotlearn.robots  # noqa: F401  (registers the environment)
from cotlearn.robots.push_t import GOAL, PushTVectorSim, corners, coverage, random_state
from cotlearn.robots.push_t.constants import AREA, MAX_STEPS, RECTANGLES
from cotlearn.robots.push_t.environment import PushT
from cotlearn.robots.push_t.geometry import coverage_of_one
from cotlearn.robots.push_t.rasteriser import AGENT, BLOCK, CROSS, OUTLINE, draw

ID = "cotlearn/PushT-v0"
poses = st.tuples(
    st.floats(100, 412), st.floats(100, 412), st.floats(-10, 10) | st.sampled_from([0.0, GOAL[2]])
)


def pushing(state, generator):
    """An action near the middle of the T."""
    return np.clip(np.array(state[2:4]) + generator.normal(0, 40, 2), 0, 512).astype(np.float32)


# --- geometry ---------------------------------------------------------------------------------


def by_shapely(pose):
    from shapely import box
    from shapely.affinity import rotate, translate
    from shapely.ops import unary_union

    tee = unary_union([box(x0, y0, x1, y1) for x0, x1, y0, y1 in RECTANGLES])

    def at(x, y, angle):
        return translate(rotate(tee, angle, origin=(0, 0), use_radians=True), x, y)

    return at(*pose).intersection(at(*GOAL)).area / AREA


@given(poses)
@settings(deadline=None, max_examples=300)
def test_coverage_is_that_of_shapely(pose):
    assert coverage(pose) == pytest.approx(by_shapely(pose), abs=1e-9)
    assert coverage_of_one(*pose) == pytest.approx(float(coverage(pose)), abs=1e-12)


@given(st.floats(-1e-3, 1e-3), st.floats(-1e-3, 1e-3), st.floats(-1e-5, 1e-5), st.integers(-3, 3))
def test_coverage_of_nearly_coincident_poses(dx, dy, turn, turns):
    pose = (GOAL[0] + dx, GOAL[1] + dy, GOAL[2] + turn + 2 * math.pi * turns)
    lost = 1 - coverage(pose)
    assert -1e-12 <= lost < 1e-4
    assert coverage_of_one(*pose) == pytest.approx(1 - lost, abs=1e-12)


@pytest.mark.parametrize("tiny", [0.0, 5e-324, 1e-310, 1e-200, 1e-17])
def test_coverage_of_the_goal_is_one(tiny):
    assert coverage((GOAL[0] + tiny, GOAL[1], GOAL[2] + tiny)) == pytest.approx(1, abs=1e-12)
    assert coverage_of_one(GOAL[0], GOAL[1], GOAL[2] + tiny) == pytest.approx(1, abs=1e-12)


def test_coverage_by_counting_points():
    generator = np.random.default_rng(0)
    pose = np.array([270.0, 240.0, 1.2])
    x, y = generator.uniform(0, 512, (2, 400_000))

    def inside(pose):
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        u = cos * (x - pose[0]) + sin * (y - pose[1])
        v = cos * (y - pose[1]) - sin * (x - pose[0])
        parts = [(u > x0) & (u < x1) & (v > y0) & (v < y1) for x0, x1, y0, y1 in RECTANGLES]
        return np.any(parts, axis=0)

    goal = inside(GOAL)
    assert coverage(pose) == pytest.approx((goal & inside(pose)).sum() / goal.sum(), abs=0.01)


def test_coverage_takes_any_batch():
    pose = np.random.default_rng(0).uniform(200, 300, (4, 5, 3))
    assert coverage(pose).shape == (4, 5)
    assert coverage(pose)[2, 3] == coverage(pose[2, 3])
    assert coverage(np.empty((0, 3))).shape == (0,)
    assert coverage((900.0, 900.0, 0.0)) == pytest.approx(0, abs=1e-12)
    assert coverage_of_one(900.0, 900.0, 0.0) == 0


def test_corners_turn_about_the_middle_of_the_bar():
    points = corners((100.0, 200.0, math.pi / 2))
    assert points[0] == pytest.approx([100, 140])
    assert points[4] == pytest.approx([-20, 215])


# --- environment ------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:.*normalized space")
@pytest.mark.parametrize("obs_type", ["state", "keypoints", "pixels", "pixels_agent_pos"])
def test_gymnasium_finds_no_fault(obs_type, monkeypatch):
    """From starts that are the same each time: a T in a wall is outside the space, as it may be."""
    drawn = seeding.np_random
    monkeypatch.setattr(seeding, "np_random", lambda seed=None: drawn(0 if seed is None else seed))
    check_env(gymnasium.make(ID, obs_type=obs_type, render_mode="rgb_array").unwrapped)


def test_the_same_seed_gives_the_same_episode():
    runs = []
    for _ in range(2):
        env = gymnasium.make(ID)
        generator = np.random.default_rng(1)
        states = [env.reset(seed=7)[0]]
        states += [env.step(pushing(states[-1], generator))[0] for _ in range(100)]
        runs.append(np.array(states))
    assert np.array_equal(*runs)
    assert tuple(runs[0][0, :4]) == random_state(np.random.default_rng(7))[:4]
    assert not np.array_equal(env.reset(seed=8)[0], runs[0][0])


def test_an_episode_ends_after_300_steps():
    env = gymnasium.make(ID)
    env.reset(options={"state": [100, 100, 300, 300, 0]})
    for step in range(1, MAX_STEPS + 1):
        _, reward, terminated, truncated, info = env.step(np.array([100.0, 100.0], np.float32))
        assert not terminated
        assert truncated == (step == MAX_STEPS)
    assert reward == pytest.approx(info["coverage"] / 0.95)


def test_covering_the_goal_ends_the_episode():
    env = gymnasium.make(ID)
    observation, info = env.reset(options={"state": [50, 50, *GOAL]})
    assert observation == pytest.approx([50, 50, *GOAL])
    assert info["is_success"]
    _, reward, terminated, _, info = env.step(np.array([50.0, 50.0], np.float32))
    assert (reward, terminated, info["is_success"]) == (1.0, True, True)


def test_vector_environments_agree_with_single_ones():
    env = gymnasium.make_vec(ID, num_envs=3)
    observation, _ = env.reset(seed=5)
    sim = PushTVectorSim.from_seeds([5, 6, 7])
    generator = np.random.default_rng(0)
    for _ in range(50):
        action = np.array([pushing(state, generator) for state in observation])
        observation, _, terminated, _, info = env.step(action)
        sim.step(action)
        assert not terminated.any()
        assert np.array_equal(observation[:, :4], sim.states[:, :4])
        assert np.array_equal(info["coverage"], sim.coverage)


def test_inactive_simulations_stand_still():
    sim = PushTVectorSim([[100, 100, 300, 300, 0]] * 2)
    sim.step([[200, 200], [math.nan, 0]], active=np.array([True, False]))
    assert sim.states[1, :2].tolist() == [100, 100]
    assert sim.states[0, 0] > 101


def test_keypoints_are_corners():
    env = gymnasium.make(ID, obs_type="keypoints")
    observation, _ = env.reset(options={"state": [50, 60, 200, 210, 0]})
    assert observation["agent_pos"].tolist() == [50, 60]
    points = observation["environment_state"].reshape(8, 2) - [200, 210]
    assert points[[0, 2, 6]].tolist() == [[-60, 0], [60, 30], [15, 120]]


def test_pictures_show_what_is_where():
    state = (100, 400, 350, 100, 0.0)
    picture = draw(state, size=512, action=(300.0, 450.0))
    assert picture.dtype == np.uint8
    assert tuple(picture[400, 100]) == AGENT
    assert tuple(picture[100 + 60, 350]) == BLOCK
    assert tuple(picture[450, 300]) == CROSS
    x, y = corners(GOAL, [(0.0, 60.0)])[0].round().astype(int)
    assert tuple(picture[y, x]) == OUTLINE
    assert tuple(picture[300, 480]) == (255, 255, 255)
    small = draw(state, size=96)
    assert np.abs(small.astype(float).mean() - draw(state, size=512).mean()) < 1
    env = gymnasium.make(ID, render_mode="rgb_array")
    env.reset(seed=0)
    assert env.render().shape == (512, 512, 3)


@pytest.mark.parametrize(
    ("action", "error", "message"),
    [
        ([math.nan, 1.0], ValueError, "action must be finite, got"),
        ([math.inf, 1.0], ValueError, "action must be finite"),
        ([-0.5, 1.0], ValueError, "action must lie between .*; got values from -0.5 to 1"),
        ([1.0, 512.5], ValueError, "clip them"),
        ([1.0], ValueError, r"action must have shape \(2,\), got \(1,\)"),
        ([[1.0, 2.0]], ValueError, r"got \(1, 2\)"),
        (["left", "up"], TypeError, r"action must hold real numbers, got \['left', 'up'\]"),
        ([True, False], TypeError, "got bool"),
        ([1j, 1.0], TypeError, "got complex128"),
        (None, TypeError, "got None"),
    ],
)
def test_bad_actions(action, error, message):
    env = PushT()
    env.reset(seed=0)
    with pytest.raises(error, match=message):
        env.step(action)
    assert env.step(np.array([100, 100]))  # integers are numbers, and the episode goes on


def test_other_bad_input():
    with pytest.raises(ValueError, match="obs_type must be one of state, keypoints, pixels, "):
        gymnasium.make(ID, obs_type="picture")
    with pytest.raises(ValueError, match="render_mode must be one of rgb_array"):
        PushT(render_mode="human")
    with pytest.raises(gymnasium.error.ResetNeeded):
        gymnasium.make(ID).step(np.ones(2, np.float32))
    for options, message in (
        ({"reset_to_state": [0] * 5}, "options must be"),
        ({"state": [0, 0, 600, 0, 0]}, "state must lie between"),
        ({"state": [1, 2, 3, 4, math.nan]}, r"state must be finite, got \[nan\]"),
    ):
        with pytest.raises(ValueError, match=message):
            PushT().reset(options=options)


# --- parity -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def peer():
    peers.peer("gym_pusht")
    theirs = push_t_peer.make()
    names = theirs.step.__globals__  # of its module, which cannot be imported again
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(names, "pymunk_to_shapely", remembered(names["pymunk_to_shapely"]))
        yield push_t_peer, theirs


def remembered(to_shapely):
    """Keeps the polygons of known poses: gym-pusht makes those of the goal anew in every step."""
    kept = {}

    def at(tee, shapes):  # always of the same T, so that its pose says all
        pose = (*tee.position, tee.angle)
        if pose not in kept:
            kept[pose] = to_shapely(tee, shapes)
        return kept[pose]

    return at


def test_spaces_and_starts_of_gym_pusht(peer):
    module, theirs = peer
    ours = PushT()
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    for seed in range(20):
        with module.without_counter():
            expected, _ = theirs.reset(seed=seed)
        assert ours.reset(seed=seed)[0] == pytest.approx(expected, abs=1e-10)


WHOLE = [("random", 200, 50), ("pushing", 20, 300)]
SAMPLE = [("random", 15, 50), ("pushing", 3, 300)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "episodes", "steps"),
    [*SAMPLE, *(pytest.param(*some, marks=pytest.mark.slow) for some in WHOLE)],
)
def test_dynamics_of_gym_pusht(peer, kind, episodes, steps):
    """Positions to 1e-3 pixels and coverage to 1e-6, over whole episodes from the same starts.

    Random episodes are cut after 50 steps to save time; benchmarks/push_t_speed.py runs them all.
    """
    module, theirs = peer
    ours = PushT()
    for seed in range(episodes):
        generator = np.random.default_rng([seed, 1])
        state, _ = ours.reset(seed=seed)
        with module.without_counter():
            theirs.reset(seed=seed)
        for _ in range(steps):
            drawn = generator.uniform(0, 512, 2) if kind == "random" else pushing(state, generator)
            action = drawn.astype(np.float32)
            expected, reward, terminated, _, info = theirs.step(action)
            state, our_reward, our_terminated, _, our_info = ours.step(action)
            assert np.abs(state[:4] - expected[:4]).max() < 1e-3
            assert abs(math.remainder(state[4] - expected[4], 2 * math.pi)) < 1e-5
            assert abs(our_info["coverage"] - info["coverage"]) <= 1e-6
            assert abs(our_reward - reward) <= 1e-6
            assert our_terminated == terminated
