import importlib
import os
import sys

import numpy as np
import pytest

from cotlearn.robots.arm import MODES, ArmVectorSim, random_start
from cotlearn.robots.arm import model as models
from cotlearn.robots.arm.constants import GOAL, HIGH, KINDS, LOW, MAX_STEPS, TIP, columns, pillars
from cotlearn.robots.arm.modes import mode_of_path


def line(sim, lift=0.0):
    """Targets (40, n, 3) straight from start to goal, lifted in the middle."""
    state = sim.states
    start, goal = state[:, TIP], state[:, GOAL]
    t = np.arange(1, MAX_STEPS + 1)[:, None, None] / MAX_STEPS
    share = 10 * t**3 - 15 * t**4 + 6 * t**5
    targets = start + share * (goal - start)
    targets[..., 2:] += lift * np.sin(np.pi * share)
    return targets


def run(sim, targets):
    for target in targets:
        sim.step(target)
    return sim.outcomes()


def check(outcomes, **expected):
    for name, values in expected.items():
        assert np.array_equal(outcomes[name], values), name


@pytest.mark.parametrize("kind", KINDS)
def test_starts(kind):
    states = np.array([random_start(np.random.default_rng(seed), kind) for seed in range(200)])
    assert states.shape == (200, len(columns(kind)))
    assert np.array_equal(states[3], random_start(np.random.default_rng(3), kind))
    posts = pillars(states)
    assert posts.shape[1] == {"ring": 1, "avoid": 5}[kind]
    for place in (TIP, GOAL):
        away = np.linalg.norm(states[:, None, place][..., :2] - posts[..., :2], axis=-1)
        assert (away > posts[..., 2] + 0.04).all()
        assert ((states[:, place] > LOW) & (states[:, place] < HIGH)).all()
    if kind == "ring":  # every direction comes up, and the pillar is in between
        start, goal = (states[:, place][:, :2] - posts[:, 0, :2] for place in (TIP, GOAL))
        turn = np.arctan2(start[:, 1], start[:, 0])
        assert np.histogram(turn, 4, (-np.pi, np.pi))[0].min() > 25
        assert ((start * goal).sum(axis=1) < 0).all()
    else:
        assert (np.diff(posts[..., 1])[:, [0, 2, 3]] > 0.1).all()  # a row of two, and of three


def test_simulations_begin_where_they_should_and_do_not_move_by_themselves():
    sim = ArmVectorSim.from_seeds([5, 6], "ring")
    state = sim.states
    starts = [random_start(np.random.default_rng(seed), "ring") for seed in (5, 6)]
    assert np.abs(state - starts).max() < 1.1e-4
    run(sim, np.repeat(state[None, :, TIP], 5, axis=0))
    assert np.abs(sim.states - state).max() < 2e-4
    assert not sim.done.any()
    assert np.array_equal(sim.outcomes()["mode"], [-1, -1])


def test_over_the_pillar_is_a_success_and_straight_through_it_a_collision():
    sim = ArmVectorSim.from_seeds(range(6), "ring")
    targets = line(sim, lift=0.2)
    behind = []
    for target in targets:
        sim.step(target)
        behind.append(np.linalg.norm(sim.states[:, TIP] - target, axis=1))
    assert np.mean(behind) < 0.002  # the arm follows
    assert np.max(behind) < 0.005
    outcomes = sim.outcomes()
    assert sim.done.all()
    assert not sim.finished.any()
    check(outcomes, success=[1] * 6, collision=[0] * 6, mode=[MODES["ring"].index("over")] * 6)
    assert outcomes["goal_error"].max() < 2e-4
    assert sim.touched() == [""] * 6

    sim = ArmVectorSim.from_seeds(range(6), "ring")
    check(run(sim, line(sim)), success=[0] * 6, collision=[1] * 6, mode=[-1] * 6)
    assert sim.finished.all()
    assert sim.touched() == ["pillar1"] * 6


def test_touching_the_table_is_a_collision():
    sim = ArmVectorSim.from_seeds([0], "ring")
    low = sim.states[:, TIP].copy()
    low[:, 2] = -0.02
    run(sim, np.repeat(low[None], 3, axis=0))
    assert sim.finished.all()
    assert sim.touched() == ["table"]


def test_missing_the_goal_is_neither():
    sim = ArmVectorSim.from_seeds([0, 1], "ring")
    targets = line(sim, lift=0.2)
    targets[:, 0, 2] += np.linspace(0, 0.05, MAX_STEPS)
    outcomes = run(sim, targets)
    check(outcomes, success=[0, 1], collision=[0, 0])
    assert outcomes["goal_error"][0] == pytest.approx(0.05, abs=1e-3)
    assert outcomes["mode"][0] == -1


def test_a_world_does_not_depend_on_the_others_and_can_stand_still():
    together, alone = (ArmVectorSim.from_seeds(seeds, "avoid") for seeds in ([3, 4, 5], [4]))
    target = together.states[:, TIP] + [0.0, 0.01, 0.02]
    active = np.array([False, True, True])
    before = together.states
    for _ in range(3):
        together.step(np.where(active[:, None], target, np.nan), active=active)
        alone.step(target[1:2])
    assert np.array_equal(together.states[0], before[0])
    assert np.abs(together.states[1] - alone.states[0]).max() < 1e-9


def test_a_target_out_of_reach_is_approached_and_told():
    sim = ArmVectorSim.from_seeds([0, 1], "ring")
    here = sim.states[:, TIP]
    high = here + np.array([0, 0, 0.2])
    sim.step(np.array([[0.3, 0.4, 3.0], high[1]]))
    assert np.array_equal(sim.unreachable, [True, False])
    sim.step(high)
    assert np.array_equal(sim.unreachable, [False, False])
    assert np.array_equal(sim.outcomes()["unreachable"], [1, 0])


def test_no_joint_turns_faster_than_it_may():
    sim = ArmVectorSim.from_seeds([0], "ring")
    before = sim.joints.copy()
    sim.step(sim.states[:, TIP] + [0, 0, 0.3])
    assert 0.17 < np.abs(sim.joints - before).max() <= 0.2611


def test_the_arm_cannot_pass_through_itself():
    sim = ArmVectorSim.from_seeds([0], "ring")
    folded = np.array([[0.0, -1.76, 0.0, -3.07, 0.0, 0.3, 0.8]])
    for _ in range(15):
        sim._lead(np.array([0]), folded, np.array([False]))
    assert sim.finished.all()
    assert sim.touched()[0] in ("the arm itself", "pillar1", "table")


def start(**changes):
    state = random_start(np.random.default_rng(0), "ring")
    names = columns("ring")
    for name, value in changes.items():
        state[names.index(name.replace("_", " "))] = value
    return state[None]


def test_starts_that_cannot_be():
    tip_inside, goal_inside = start(), start()
    tip_inside[:, TIP] = goal_inside[:, GOAL] = [*tip_inside[0, 6:8], 0.05]
    for states, what, why in (
        (tip_inside, r"tip \[.*\]", "in pillar1"),
        (goal_inside, r"goal \[.*\]", "in pillar1"),
        (start(goal_x=1.2), "goal .*", "out of reach: the tip"),
        (start(tip_z=-0.03), "tip .*", "in table"),
    ):
        with pytest.raises(ValueError, match=rf"the {what} of states\[0\] is {why}"):
            ArmVectorSim(states, "ring")


def test_modes_of_paths():
    states = np.tile(start(tip_x=0.3, tip_y=0, goal_x=0.7, goal_y=0), (6, 21, 1))[:5]
    states[..., 6:] = [0.5, 0.0, 0.04, 0.15]
    t = np.linspace(0, 1, 21)
    states[..., 0] = 0.3 + 0.4 * t
    bump = np.sin(np.pi * t)
    states[0, :, 1], states[1, :, 1], states[2, :, 2] = 0.1 * bump, -0.1 * bump, 0.25 * bump
    states[3, :, 1], states[3, :, 2] = 0.1 * bump, 0.16 * bump  # higher than the pillar, but beside
    states[4, :, 0] = 0.3  # never passes
    assert mode_of_path(states, "ring").tolist() == [0, 1, 2, 0, -1]

    state = random_start(np.random.default_rng(0), "avoid")
    posts = pillars(state)
    for mode in range(12):
        path = np.tile(state, (4, 1))
        for row, way in enumerate(divmod(mode, 4)):
            group = posts[2:] if row else posts[:2]
            edges = [-1.0, *group[:, 1], 1.0]
            path[row + 1, :2] = group[:, 0].mean(), (edges[way] + edges[way + 1]) / 2
        path[3, :3] = state[GOAL]
        assert mode_of_path(path[None], "avoid").tolist() == [mode]
        assert mode_of_path(path[None, :3] - [0.02, *[0] * 25], "avoid").tolist() == [-1]
    assert len(MODES["avoid"]) == 12


def test_pillars_stand_where_the_state_says():
    """The tip is lowered onto a pillar: it is touched at its height."""
    x, y, _, height = pillars(random_start(np.random.default_rng(2), "ring"))[0]
    sim = ArmVectorSim.from_seeds([2], "ring")
    above = np.array([[x, y, height + 0.05]])
    sim.step(sim.states[:, TIP] + [0, 0, 0.2])
    for _ in range(10):
        sim.step(above)
    assert not sim.finished.any()
    for z in np.arange(height + 0.05, height - 0.02, -0.004):
        sim.step(np.array([[x, y, z]]))
    assert sim.touched() == ["pillar1"]
    assert sim.states[0, 2] == pytest.approx(height, abs=0.004)


def test_without_mujoco_it_is_told_how_to_get_it(monkeypatch):
    models.mujoco.cache_clear()
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match="the arm needs MuJoCo; install it with: pip"):
        ArmVectorSim.from_seeds([0], "ring")
    monkeypatch.undo()
    models.mujoco.cache_clear()


def test_physics_need_no_opengl(monkeypatch):
    """Some versions cannot even be imported when the OpenGL that MUJOCO_GL names is missing."""
    seen, real = [], importlib.import_module

    def without_egl(name):
        seen.append(os.environ["MUJOCO_GL"])
        if seen[-1] == "egl":
            raise ImportError("Cannot initialize a EGL device display")
        return real(name)

    models.mujoco.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setattr(models.importlib, "import_module", without_egl)
    assert models.mujoco().mj_step
    assert seen == ["egl", "disable"]
    assert os.environ["MUJOCO_GL"] == "egl"
    models.mujoco.cache_clear()
