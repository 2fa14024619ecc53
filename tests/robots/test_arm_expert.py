import hashlib
import importlib.metadata
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from typer.testing import CliRunner

from cotlearn import assets, cli
from cotlearn.robots.arm import MAX_STEPS, SUCCESS, WAYS, ArmWorlds, random_start
from cotlearn.robots.arm.definition import ARM_AVOID, ARM_RING
from cotlearn.robots.arm.task import GOAL, KINDS, TIP, columns, pillars
from cotlearn.robots.arm.ways import way_round
from cotlearn.robots.experts import record as recording
from cotlearn.robots.experts.arm import ArmExpert, Episode, minimum_jerk, via_points
from cotlearn.robots.experts.arm.expert import NOISE, UNIT
from cotlearn.robots.experts.arm.path import CLEARANCE, clearance

SHIPPED = {kind: f"arm_{kind}_demos.npz" for kind in KINDS}


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
    at = np.linspace(0, 1, n)
    ours = minimum_jerk(points, times, at)[:, 0]

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
    assert np.allclose(clearance(tips, post)[:2], [0.05, 0.05])
    assert clearance(tips, post)[2] < 0
    assert abs(clearance(tips, post)[3]) < 1e-12


@pytest.mark.parametrize("kind", KINDS)
def test_every_way_has_a_path_that_is_clear(kind):
    expert, ways = ArmExpert(kind), len(WAYS[kind])
    rng = np.random.default_rng(0)
    states = np.array([random_start(np.random.default_rng(n), kind) for n in range(5 * ways)])
    for number, state in enumerate(states):
        path = expert.path(state, number % ways, rng)
        assert path.shape == (MAX_STEPS, 3)
        assert np.allclose(path[-1], state[GOAL])
        assert clearance(path, pillars(state)).min() >= CLEARANCE - 1e-3
        tips = np.tile(state, (MAX_STEPS + 1, 1))
        tips[1:, TIP] = path
        assert way_round(tips[None], kind)[0] == number % ways


def test_via_points_differ_from_draw_to_draw():
    state, rng = random_start(np.random.default_rng(0), "ring"), np.random.default_rng(0)
    assert not np.array_equal(via_points(state, 0, "ring", rng), via_points(state, 0, "ring", rng))


@pytest.mark.parametrize(
    ("points", "times", "message"),
    [
        ([[0.0], [1.0]], [0.0, 1.0, 2.0], "points and times must have shapes"),
        ([[0.0], [1.0], [2.0]], [0.0, 1.0, 1.0], r"times must rise, got \[0.0, 1.0, 1.0\]"),
    ],
)
def test_bad_paths(points, times, message):
    with pytest.raises(ValueError, match=message):
        minimum_jerk(points, times, [0.0])


# --- the demonstrator -------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_episodes(kind):
    expert = ArmExpert(kind)
    episodes = [expert.episode(seed) for seed in range(12)]
    assert sum(episode.success for episode in episodes) >= 11
    for seed, episode in enumerate(episodes):
        assert episode.state.shape == (MAX_STEPS, len(columns(kind)))
        assert episode.action.shape == episode.intention.shape == (MAX_STEPS, 3)
        for array in (episode.action, episode.intention):
            assert np.array_equal(np.rint(array / UNIT) * UNIT, array)
        assert np.array_equal(episode.state[0], ArmWorlds([seed], kind).states[0])
        assert np.allclose(episode.intention[-1], episode.state[0, GOAL], atol=UNIT)
    off = np.concatenate([episode.action - episode.intention for episode in episodes])
    assert off.std() == pytest.approx(NOISE, rel=0.1)


def test_noise_is_recovered_from_at_once():
    """After a disturbed step the tip is back where it was meant to be in the next."""
    episode = ArmExpert("ring", noise=0.01).episode(3)
    off = np.linalg.norm(episode.state[1:, TIP] - episode.intention[:-1], axis=1)
    added = np.linalg.norm(episode.action - episode.intention, axis=1)[:-1]
    assert np.corrcoef(off, added)[0, 1] > 0.9
    assert np.abs(off - added).mean() < 0.003


def test_the_same_seed_gives_the_same_episode_and_any_way_can_be_asked_for():
    expert = ArmExpert("ring")
    one, other = expert.episode(5), ArmExpert("ring").episode(5)
    for name in ("state", "action", "intention", "mode", "success"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    for way in range(3):
        episode = expert.episode(5, way=way)
        assert episode.mode == way
        assert episode.success
        assert np.array_equal(episode.state[0], one.state[0])
    elsewhere = expert.episode(5, state=random_start(np.random.default_rng(6), "ring"))
    assert np.array_equal(elsewhere.state[0], ArmWorlds([6], "ring").states[0])


def test_what_touches_something_is_no_success():
    """With noise of 3 cm many do."""
    expert = ArmExpert("avoid", noise=0.03)
    episodes = [expert.episode(seed) for seed in range(6)]
    assert not all(episode.success for episode in episodes)
    assert {len(episode.state) for episode in episodes} == {MAX_STEPS}


def test_bad_requests():
    with pytest.raises(ValueError, match="way must be from 0 to 2, got 3"):
        ArmExpert("ring").episode(0, way=3)
    with pytest.raises(ValueError, match="kind must be"):
        ArmExpert("circle")
    with pytest.raises(ValueError, match="noise must be"):
        ArmExpert("ring", noise=-1)
    state = random_start(np.random.default_rng(0), "ring")
    state[TIP] = [*state[6:8], 0.05]
    with pytest.raises(ValueError, match="is in pillar1"):
        ArmExpert("ring").episode(0, state=state)


# --- recordings -------------------------------------------------------------------------------


class Quick:
    """Episodes that cost nothing; every fifth seed fails."""

    def episode(self, seed):
        rng = np.random.default_rng(seed)
        values = np.rint(rng.uniform(-1, 1, (6, 16)) / UNIT) * UNIT
        return Episode(values[:, :10], values[:, 10:13], values[:, 13:], seed % 3, seed % 5 != 0)


@pytest.fixture
def quick(monkeypatch):
    recipe = recording.RECIPES["arm-ring"]
    monkeypatch.setitem(recording.RECIPES, "arm-ring", replace(recipe, expert=Quick))
    monkeypatch.setattr(recording, "PART", 4)


def test_recordings_have_the_mode_and_can_be_interrupted(quick, tmp_path, monkeypatch):
    about = recording.record(tmp_path / "a", "arm-ring", episodes=10, seed=1, show_progress=False)
    found = recording.load(tmp_path / "a")
    assert found.about == about
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
            recording.record(tmp_path / "b", "arm-ring", episodes=10, seed=1, show_progress=False)
    recording.record(tmp_path / "b", "arm-ring", episodes=10, seed=1, show_progress=False)
    assert (tmp_path / "b").read_bytes() == (tmp_path / "a").read_bytes()
    with pytest.raises(ValueError, match="holds another recording"):
        recording.record(tmp_path / "a", "arm-avoid", episodes=10, seed=1, show_progress=False)


def test_an_unknown_task(tmp_path):
    with pytest.raises(ValueError, match="task must be"):
        recording.record(tmp_path / "a", "arm", episodes=1, seed=0)
    recording.write(tmp_path / "a", {}, {"task": "juggling"})
    with pytest.raises(ValueError, match="demonstrations of an unknown task, 'juggling'"):
        recording.load(tmp_path / "a")


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
def test_the_shipped_file_is_the_one_that_data_describes(kind):
    path = assets.find_data(SHIPPED[kind])
    text = assets.find_data("README.md").read_text(encoding="utf-8")
    digest = re.search(r"`([0-9a-f]{64})`", text.split(f"## `{SHIPPED[kind]}`")[1])[1]
    assert hashlib.sha256(path.read_bytes()).hexdigest() == digest
    found = recording.load(path)
    assert found.about["episodes"] == len(found.seed) == 4000
    assert found.about["replaced"] / 4000 < 0.004
    assert len(set(found.seed.tolist())) == 4000
    assert np.array_equal(np.diff(found.episode_ends, prepend=0), np.full(4000, MAX_STEPS))
    counts = np.bincount(found.mode, minlength=len(WAYS[kind]))
    assert len(counts) == len(WAYS[kind])
    assert counts.min() > 0.85 * 4000 / len(counts)


def test_both_files_are_small():
    assert sum(assets.find_data(name).stat().st_size for name in SHIPPED.values()) < 10e6


@pytest.mark.parametrize("kind", KINDS)
def test_shipped_episodes_can_be_replayed(kind):
    """To the rounding of the file; other versions of MuJoCo may be centimetres off at times."""
    found = recording.load(assets.find_data(SHIPPED[kind]))
    same = found.about["versions"]["mujoco"] == importlib.metadata.version("mujoco")
    tolerance = UNIT / 2 + (1e-3 if same else 0.03)
    chosen = [0, 1234, 3999]
    worlds = ArmWorlds([int(found.seed[episode]) for episode in chosen], kind)
    begin = found.episode_ends[chosen] - MAX_STEPS
    for step in range(MAX_STEPS):
        assert np.abs(worlds.states - found.state[begin + step]).max() < tolerance
        worlds.step(found.action[begin + step])
    outcomes = worlds.outcomes()
    assert np.array_equal(outcomes["mode"], found.mode[chosen])
    assert outcomes["goal_error"].max() < SUCCESS


def test_the_frame_takes_away_variance_between_conditions():
    """Of whole paths around the pillar, and of chunks between the rows."""
    for task, length in ((ARM_RING, MAX_STEPS), (ARM_AVOID, 16)):
        found = recording.load(assets.find_data(f"{task.name.replace('-', '_')}_demos.npz"))
        states = found.state.reshape(-1, MAX_STEPS, len(task.state))[:500, ::12]
        actions = found.intention.reshape(-1, MAX_STEPS, 3)[:500]
        left = {}
        for name, frame in task.frames.items():
            steps = range(0, MAX_STEPS - length + 1, 12)
            seen = [
                frame.into(actions[:, step : step + length], states[:, place : place + 1])
                for place, step in enumerate(steps)
            ]
            left[name] = np.concatenate(seen).var(axis=0).sum(axis=-1).mean()
        assert left["goal"] < 0.6 * left["world"]
