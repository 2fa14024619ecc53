import numpy as np
import pytest
from peers import peer

from cotlearn.robots.arm import forward, random_start, solve
from cotlearn.robots.arm.constants import GOAL, KINDS, TIP
from cotlearn.robots.arm.kinematics import LOWER, REST, SPEED, TILT, TOLERANCE, UPPER
from cotlearn.robots.arm.model import model_of, mujoco


@pytest.fixture(scope="module")
def model():
    return model_of(random_start(np.random.default_rng(0), "ring"))


def test_the_model_has_the_published_kinematics(model):
    """MuJoCo's positions and Jacobian against ours, and ours against finite differences."""
    engine, data = mujoco(), mujoco().MjData(model)
    angles = np.random.default_rng(0).uniform(LOWER, UPPER, (50, 7))
    chain = forward(angles)
    jacobian, turning = np.zeros((3, 7)), np.zeros((3, 7))
    for row, q in enumerate(angles):
        data.qpos[:] = q
        engine.mj_forward(model, data)
        site = model.site("tip").id
        engine.mj_jacSite(model, data, jacobian, turning, site)
        assert np.abs(data.site_xpos[site] - chain.tip[row]).max() < 1e-12
        assert np.abs(jacobian - chain.jacobian[row]).max() < 1e-12
        down = data.site_xmat[site].reshape(3, 3)[:, 2]
        assert np.abs(down - chain.down[row]).max() < 1e-12
        assert np.abs(np.cross(turning.T, down).T - chain.tilting[row]).max() < 1e-12
        assert np.abs(data.xpos[model.body("link7").id] - chain.origins[row, 6]).max() < 1e-12
    step = 1e-6 * np.eye(7)
    for joint in range(7):
        ahead, behind = forward(angles + step[joint]), forward(angles - step[joint])
        slope = (ahead.tip - behind.tip) / 2e-6
        assert np.abs(slope - chain.jacobian[..., joint]).max() < 1e-8
        slope = (ahead.down - behind.down) / 2e-6
        assert np.abs(slope - chain.tilting[..., joint]).max() < 1e-8


def test_limits_are_those_of_the_model(model):
    assert np.allclose(model.jnt_range, np.stack([LOWER, UPPER], axis=1))
    assert ((REST > LOWER) & (REST < UPPER)).all()
    assert SPEED.shape == (7,)


@pytest.mark.parametrize("kind", KINDS)
def test_every_start_and_goal_can_be_reached(kind):
    states = np.array([random_start(np.random.default_rng(seed), kind) for seed in range(500)])
    for place in (TIP, GOAL):
        found = solve(states[:, place])
        assert found.reached.all()
        assert found.error.max() <= TOLERANCE
        assert found.tilt.max() <= TILT
        assert ((found.joints >= LOWER) & (found.joints <= UPPER)).all()
        chain = forward(found.joints)
        assert np.abs(chain.tip - states[:, place]).max() <= TOLERANCE
        assert (chain.down[:, 2] < -1 + TILT).all()


def test_from_nearby_it_stays_close():
    rng = np.random.default_rng(0)
    places = np.column_stack(
        [rng.uniform(0.35, 0.65, 300), rng.uniform(-0.2, 0.2, 300), rng.uniform(0.04, 0.25, 300)]
    )
    joints = solve(places).joints
    found = solve(places + rng.normal(0, 0.015, places.shape), joints)
    assert found.reached.all()
    assert np.abs(found.joints - joints).max() < 0.3


def test_a_row_does_not_depend_on_the_others_and_nothing_is_changed():
    rng = np.random.default_rng(1)
    targets = rng.uniform([0.3, -0.3, 0.0], [0.9, 0.3, 0.4], (20, 3))
    start = np.tile(solve(np.array([[0.5, 0.0, 0.1]])).joints, (20, 1))
    before = targets.copy(), start.copy()
    together = solve(targets, start)
    assert not together.reached.all()
    for row in range(20):
        alone = solve(targets[row : row + 1], start[row : row + 1])
        assert np.abs(alone.joints[0] - together.joints[row]).max() < 1e-9
        assert alone.reached[0] == together.reached[row]
    assert np.array_equal(targets, before[0])
    assert np.array_equal(start, before[1])


def test_what_is_out_of_reach_is_told_and_approached():
    targets = np.array([[1.2, 0, 0.1], [0.1, 0, 0.0], [0.85, 0.45, 0.6], [0.5, 0, -3], [1e9, 0, 0]])
    start = np.tile(solve(np.array([[0.5, 0.0, 0.1]])).joints, (5, 1))
    for found in (solve(targets), solve(targets, start)):
        assert not found.reached.any()
        assert np.isfinite(found.joints).all()
        assert ((found.joints >= LOWER) & (found.joints <= UPPER)).all()
    assert np.linalg.norm(forward(found.joints).tip[0] - targets[0]) < 0.6


def test_another_solver_agrees(model):
    """The solution of mink holds the tool where ours does."""
    mink = peer("mink")
    target = np.array([0.55, 0.1, 0.12])
    ours = solve(target[None]).joints[0]
    configuration = mink.Configuration(model)
    configuration.update(ours + 0.05)
    task = mink.FrameTask("tip", "site", position_cost=1.0, orientation_cost=0.0)
    goal = mink.SE3.from_translation(target)
    task.set_target(goal)
    for _ in range(100):
        velocity = mink.solve_ik(configuration, [task], 0.1, solver="daqp")
        configuration.integrate_inplace(velocity, 0.1)
    reached = configuration.get_transform_frame_to_world("tip", "site").translation()
    assert np.abs(reached - target).max() < 1e-4
    assert np.abs(forward(configuration.q[None]).tip[0] - reached).max() < 1e-9


def test_the_error_of_a_target_out_of_reach_is_its_distance():
    targets = np.array([[10.0, 0.0, 0.3], [0.0, 0.0, 2.0], [0.5, 0.0, 0.3]])
    found = solve(targets)
    away = np.linalg.norm(forward(found.joints).tip - targets, axis=1)
    assert np.abs(found.error - away).max() < 1e-9
    assert found.reached.tolist() == [False, False, True]
