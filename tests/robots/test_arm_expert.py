import importlib.metadata

import numpy as np
import pytest
from scipy.optimize import minimize
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.course import assets
from cotlearn.robots.arm import MODES, ArmVectorSim, random_start
from cotlearn.robots.arm.constants import (
    GOAL,
    KINDS,
    MAX_STEPS,
    SUCCESS,
    TIP,
    UNIT,
    columns,
    pillars,
)
from cotlearn.robots.arm.definition import ARM_AVOID, ARM_RING
from cotlearn.robots.arm.expert import ArmExpert, expert
from cotlearn.robots.arm.expert.expert import NOISE
from cotlearn.robots.arm.expert.path import CLEARANCE, clearance, minimum_jerk, via_points
from cotlearn.robots.arm.modes import mode_of_path
from cotlearn.robots.episodes import read
from cotlearn.robots.episodes import record as recording
from cotlearn.robots.episodes.npz import read_arrays, write_arrays
from cotlearn.robots.task import Demonstration

SHIPPED = {"ring": ARM_RING.demonstrations, "avoid": ARM_AVOID.demonstrations}


# --- paths ------------------------------------------------------------------------------------


def test_without_via_points_it_is_the_known_quintic():
    t = np.linspace(0, 2, 50)
    found = minimum_jerk([[0.0, 1.0], [1.0, 3.0]], [0.0, 2.0], t)
    s = t / 2
    share = 10 * s**3 - 15 * s**4 + 6 * s**5
    assert np.allclose(found, np.array([0.0, 1.0]) + share[:, None] * [1.0, 2.0])


def test_it_passes_its_points_at_their_times_and_begins_and_ends_at_rest():
    rng = np.random.default_rng(0)
    points, times = rng.normal(size=(5, 3)), np.array([1.0, 1.5, 2.5, 3.5, 4.0])
    assert np.allclose(minimum_jerk(points, times, times), points)
    h = 1e-4
    for end in (1.0, 4.0):
        near = minimum_jerk(points, times, [end - h, end, end + h])
        assert np.abs(near[2] - near[0]).max() < 1e-5
        assert np.abs(near[2] - 2 * near[1] + near[0]).max() / h**2 < 0.1


def test_nothing_has_less_jerk():
    """Against a direct minimisation over samples of the path."""
    points, times, n = np.array([[0.0], [1.0], [0.2]]), np.array([0.0, 0.4, 1.0]), 51
    ours = minimum_jerk(points, times, np.linspace(0, 1, n))[:, 0]

    def jerk(path):
        whole = np.concatenate([[points[0, 0]] * 3, path, [points[-1, 0]] * 3])
        return (np.diff(whole, n=3) ** 2).sum()

    bounds = [(None, None)] * n
    for row, value in ((0, 0.0), (20, 1.0), (n - 1, 0.2)):
        bounds[row] = (value, value)
    best = minimize(jerk, ours, bounds=bounds, options={"maxiter": 2000, "maxfun": 10**6})
    assert jerk(ours) < 1.15 * best.fun
    assert np.abs(ours - best.x).max() < 0.05


def test_clearance_is_the_distance_of_capsules():
    post = np.array([[0.5, 0.0, 0.04, 0.15]])
    tips = np.array([[0.6, 0.0, 0.05], [0.5, 0.0, 0.2], [0.5, 0.03, 0.1], [0.5, 0.0, 0.15]])
    *outside, inside, touching = clearance(tips, post)
    assert np.allclose(outside, [0.05, 0.05])
    assert inside < 0
    assert abs(touching) < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_every_mode_has_a_path_that_is_clear(kind):
    demonstrator, ways = ArmExpert(kind), len(MODES[kind])
    rng = np.random.default_rng(0)
    states = np.array([random_start(np.random.default_rng(n), kind) for n in range(5 * ways)])
    for number, state in enumerate(states):
        path = demonstrator.path(state, number % ways, rng)
        assert path.shape == (MAX_STEPS, 3)
        assert np.allclose(path[-1], state[GOAL])
        assert clearance(path, pillars(state)).min() >= CLEARANCE - 1e-3
        tips = np.tile(state, (MAX_STEPS + 1, 1))
        tips[1:, TIP] = path
        assert mode_of_path(tips[None], kind)[0] == number % ways


def test_via_points_differ_from_draw_to_draw():
    state, rng = random_start(np.random.default_rng(0), "ring"), np.random.default_rng(0)
    assert not np.array_equal(via_points(state, 0, "ring", rng), via_points(state, 0, "ring", rng))


# --- the demonstrator -------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_episodes(kind):
    episodes = [ArmExpert(kind).episode(seed) for seed in range(12)]
    assert sum(episode.success for episode in episodes) >= 11
    for seed, episode in enumerate(episodes):
        assert episode.state.shape == (MAX_STEPS, len(columns(kind)))
        assert episode.action.shape == episode.intention.shape == (MAX_STEPS, 3)
        for array in (episode.action, episode.intention):
            assert np.array_equal(np.rint(array / UNIT) * UNIT, array)
        assert np.array_equal(episode.state[0], ArmVectorSim.from_seeds([seed], kind).states[0])
        assert np.allclose(episode.intention[-1], episode.state[0, GOAL], atol=UNIT)
    off = np.concatenate([episode.action - episode.intention for episode in episodes])
    assert off.std() == pytest.approx(NOISE, rel=0.1)


def test_noise_is_recovered_from_at_once(monkeypatch):
    """After a disturbed step the tip is back where it was meant to be in the next."""
    monkeypatch.setattr(expert, "NOISE", 0.01)
    episode = ArmExpert("ring").episode(3)
    off = np.linalg.norm(episode.state[1:, TIP] - episode.intention[:-1], axis=1)
    added = np.linalg.norm(episode.action - episode.intention, axis=1)[:-1]
    assert np.corrcoef(off, added)[0, 1] > 0.9
    assert np.abs(off - added).mean() < 0.003


def test_the_same_seed_gives_the_same_episode_and_any_start_can_be_asked_for():
    one, other = ArmExpert("ring").episode(5), ArmExpert("ring").episode(5)
    for name in ("state", "action", "intention", "mode", "success"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    start = random_start(np.random.default_rng(6), "ring")
    elsewhere = ArmExpert("ring").episode(5, state=start)
    assert np.array_equal(elsewhere.state[0], ArmVectorSim.from_seeds([6], "ring").states[0])
    assert elsewhere.mode == one.mode


def test_what_touches_something_is_no_success(monkeypatch):
    """With noise of 3 cm many do."""
    monkeypatch.setattr(expert, "NOISE", 0.03)
    episodes = [ArmExpert("avoid").episode(seed) for seed in range(6)]
    assert not all(episode.success for episode in episodes)
    assert {len(episode.state) for episode in episodes} == {MAX_STEPS}


# --- recordings -------------------------------------------------------------------------------


class Quick:
    """Episodes that cost nothing; every fifth seed fails."""

    def episode(self, seed):
        rng = np.random.default_rng(seed)
        values = rng.uniform(-1, 1, (6, 16))
        values[:, 10:] = np.clip(values[:, 10:], 0.15, 0.4)
        values = np.rint(values / UNIT) * UNIT
        state, action, intention = np.split(values, [10, 13], axis=1)
        return Demonstration(state, action, intention, seed % 5 != 0, seed % 3)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setitem(vars(ARM_RING), "expert", Quick)
    monkeypatch.setattr(recording, "PART", 4)


def test_recordings_have_the_mode_and_can_be_interrupted(quick, tmp_path, monkeypatch):
    about = recording.record(tmp_path / "a.npz", "arm-ring", episodes=10, seed=1)
    found = read(tmp_path / "a.npz")
    assert read_arrays(tmp_path / "a.npz")[1] == about
    assert about["task"] == "arm-ring"
    assert about["replaced"] > 0
    assert np.array_equal(found.mode, found.seed % 3)
    for row, seed in enumerate(found.seed):
        episode = Quick().episode(int(seed))
        rows = slice(6 * row, 6 * row + 6)
        for name in ("state", "action", "intention"):
            assert np.array_equal(getattr(found, name)[rows], getattr(episode, name))

    original, calls = Quick.episode, iter(range(100))

    def interrupted(self, seed):
        if next(calls) == 7:
            raise KeyboardInterrupt
        return original(self, seed)

    with monkeypatch.context() as patch:
        patch.setattr(Quick, "episode", interrupted)
        with pytest.raises(KeyboardInterrupt):
            recording.record(tmp_path / "b", "arm-ring", episodes=10, seed=1)
    recording.record(tmp_path / "b", "arm-ring", episodes=10, seed=1)
    assert (tmp_path / "b").read_bytes() == (tmp_path / "a.npz").read_bytes()
    with pytest.raises(ValueError, match="holds another recording"):
        recording.record(tmp_path / "a.npz", "arm-avoid", episodes=10, seed=1)


def test_an_unknown_task(tmp_path):
    with pytest.raises(ValueError, match="task must be"):
        recording.record(tmp_path / "a.npz", "arm", episodes=1, seed=0)
    write_arrays(tmp_path / "a.npz", {}, {"task": "juggling"})
    with pytest.raises(ValueError, match="demonstrations of an unknown task, 'juggling'"):
        read(tmp_path / "a.npz")


def test_the_commands(quick, tmp_path):
    out = str(tmp_path / "ring.npz")
    result = CliRunner().invoke(cli.app, ["demos", "arm-ring", "--episodes", "5", "--out", out])
    assert result.exit_code == 0, result.output
    assert "5 episodes" in result.output
    result = CliRunner().invoke(cli.app, ["demos", "arm-avoid", "--episodes", "5", "--out", out])
    assert result.exit_code == 2
    assert "holds another recording" in result.output


# --- what the course ships --------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_file_has_all_modes(kind):
    path = assets.find_data(SHIPPED[kind])
    found, (_, about) = read(path), read_arrays(path)
    assert about["episodes"] == len(found.seed) == 4000
    assert about["replaced"] / 4000 < 0.004
    assert np.array_equal(found.lengths, np.full(4000, MAX_STEPS))
    counts = np.bincount(found.mode, minlength=len(MODES[kind]))
    assert len(counts) == len(MODES[kind])
    assert counts.min() > 0.85 * 4000 / len(counts)


def test_both_files_are_small():
    assert sum(assets.find_data(name).stat().st_size for name in SHIPPED.values()) < 10e6


@pytest.mark.parametrize("kind", KINDS)
def test_shipped_episodes_can_be_replayed(kind):
    """To the rounding of the file; other versions of MuJoCo may be centimetres off at times."""
    path = assets.find_data(SHIPPED[kind])
    found, (_, about) = read(path), read_arrays(path)
    same = about["versions"]["mujoco"] == importlib.metadata.version("mujoco")
    tolerance = UNIT / 2 + (1e-3 if same else 0.03)
    chosen = [0, 1234, 3999]
    worlds = ArmVectorSim.from_seeds([int(found.seed[episode]) for episode in chosen], kind)
    begin = found.starts[chosen]
    for step in range(MAX_STEPS):
        assert np.abs(worlds.states - found.state[begin + step]).max() < tolerance
        worlds.step(found.action[begin + step])
    outcomes = worlds.outcomes()
    assert np.array_equal(outcomes["mode"], found.mode[chosen])
    assert outcomes["goal_error"].max() < SUCCESS


def test_the_frame_takes_away_variance_between_conditions():
    """Of whole paths around the pillar, and of chunks between the rows."""
    for task, length in ((ARM_RING, MAX_STEPS), (ARM_AVOID, 16)):
        found = read(assets.find_data(task.demonstrations))
        states = found.state.reshape(-1, MAX_STEPS, len(task.state))[:500, ::12]
        actions = found.intention.reshape(-1, MAX_STEPS, 3)[:500]
        left = {}
        for name, frame in task.frames.items():
            steps = range(0, MAX_STEPS - length + 1, 12)
            seen = [
                frame.to_frame(actions[:, step : step + length], states[:, place : place + 1])
                for place, step in enumerate(steps)
            ]
            left[name] = np.concatenate(seen).var(axis=0).sum(axis=-1).mean()
        assert left["goal"] < 0.6 * left["world"]
