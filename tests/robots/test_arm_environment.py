import os
import shutil
import subprocess
import sys
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cotlearn.robots.arm import ArmVectorSim, random_start, rendering, skeleton
from cotlearn.robots.arm.constants import GOAL, KINDS, MAX_STEPS, PICTURE, TIP
from cotlearn.robots.arm.environment import Arm
from cotlearn.robots.arm.model import model_of
from cotlearn.robots.push_t.environment import PushT

IDS = {kind: f"cotlearn/Arm{kind.title()}-v0" for kind in KINDS}


def targets(state, lift=0.2):
    t = np.arange(1, MAX_STEPS + 1)[:, None] / MAX_STEPS
    share = 10 * t**3 - 15 * t**4 + 6 * t**5
    path = state[TIP] + share * (state[GOAL] - state[TIP])
    path[:, 2:] += lift * np.sin(np.pi * share)
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_gymnasium_accepts_it(kind):
    env = gymnasium.make(IDS[kind]).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*(symmetric and normalized|render_mode).*")
        check_env(env, skip_render_check=True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_the_start_of_the_simulations(kind):
    env = gymnasium.make(IDS[kind])
    state, info = env.reset(seed=7)
    assert np.array_equal(state, ArmVectorSim.from_seeds([7], kind).states[0])
    nothing = {"success": False, "collision": False, "touched": "", "unreachable": False}
    assert info == {**nothing, "goal_error": info["goal_error"], "mode": -1}
    again, _ = env.reset()
    assert not np.array_equal(again, state)


def test_an_episode_over_the_pillar_and_one_through_it():
    env = gymnasium.make(IDS["ring"])
    state, _ = env.reset(seed=1)
    rewards = []
    for number, target in enumerate(targets(state), start=1):
        state, reward, terminated, truncated, info = env.step(target)
        rewards.append(reward)
        assert terminated == (number == MAX_STEPS)
    assert truncated
    assert rewards == [0.0] * (MAX_STEPS - 1) + [1.0]
    assert (info["success"], info["mode"]) == (True, 2)

    state, _ = env.reset(seed=1)
    for target in targets(state, lift=0.0):
        state, reward, terminated, _, info = env.step(target)
        if terminated:
            break
    found = (info["success"], info["collision"], info["touched"])
    assert (reward, *found) == (0.0, False, True, "pillar1")

    state, _ = env.reset(seed=1)
    for target in targets(state) + np.linspace(0, 0.05, MAX_STEPS)[:, None] * [0, 0, 1]:
        state, reward, terminated, _, info = env.step(target)
    assert (terminated, info["success"], info["collision"]) == (True, False, False)
    assert reward == pytest.approx(0.0125 / info["goal_error"])
    assert reward == pytest.approx(0.25, abs=0.01)


def test_many_at_once():
    env = gymnasium.make_vec(IDS["avoid"], num_envs=3, vectorization_mode="sync")
    states, _ = env.reset(seed=5)
    assert np.array_equal(states, ArmVectorSim.from_seeds([5, 6, 7], "avoid").states)
    states, rewards, *_, info = env.step(states[:, TIP].astype(np.float32))
    assert states.shape == (3, 26)
    assert rewards.shape == info["goal_error"].shape == (3,)
    env.close()


def test_an_action_out_of_reach_is_told():
    env = Arm("ring")
    env.reset(seed=0)
    *_, info = env.step(np.array([0.85, 0.45, 0.6]))
    assert info["unreachable"]


def test_bad_actions():
    with pytest.raises(gymnasium.error.ResetNeeded):
        gymnasium.make(IDS["ring"]).step(np.zeros(3))
    env = Arm("ring")
    env.reset(seed=0)
    for action, error, message in (
        ([np.nan, 0, 0], ValueError, r"be finite, got \[nan\]"),
        ([5.0, 0.0, 0.1], ValueError, "lie between .* from 0 to 5: clip them"),
        ([0.0, 0.0], ValueError, r"have shape \(3,\), got \(2,\)"),
        (["a", "b", "c"], TypeError, "hold real numbers"),
    ):
        with pytest.raises(error, match=f"action must {message}"):
            env.step(np.array(action))


def test_starting_elsewhere():
    env = Arm("ring")
    state = random_start(np.random.default_rng(3), "ring")
    found, _ = env.reset(options={"state": state})
    assert np.abs(found - state).max() < 1.1e-4
    state[TIP] = [*state[6:8], 0.05]
    with pytest.raises(ValueError, match="is in pillar1"):
        env.reset(options={"state": state})
    with pytest.raises(ValueError, match=r"options must be \{'state': ...\} or None"):
        env.reset(options={"start": state})
    for bad, message in ((state[:4], "have shape"), (state * np.nan, "be finite")):
        with pytest.raises(ValueError, match=f"state must {message}"):
            env.reset(options={"state": bad})
    state[8] = 0.3
    with pytest.raises(ValueError, match="state: pillars need 0 < radius < height"):
        env.reset(options={"state": state})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "rings"}, "kind must be"),
        ({"render_mode": "human"}, "render_mode must be"),
        ({"camera": "side"}, "camera must be"),
        ({"width": 2000}, r"width and height must be at most \(960, 720\), got \(2000, 240\)"),
        ({"height": 0}, "height must be at least 1"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        Arm(**arguments)


# --- pictures ---------------------------------------------------------------------------------


def colours(image):
    """Shares of the picture that are orange (pillars) and green (goal)."""
    r, g, b = (image[..., k].astype(int) for k in range(3))
    return ((r > g + 50) & (g > b + 20)).mean(), ((g > r + 30) & (g > b + 20)).mean()


def check_pictures(how):
    for camera in ("front", "above"):
        env = Arm("avoid", render_mode="rgb_array", width=200, height=150, camera=camera)
        for seed in (0, 1):
            state, _ = env.reset(seed=seed)
            image = env.render()
            env.step(state[TIP] + [0, 0.05, 0.05])
            assert (env.render() != image).any()
        assert env._painter.how == how
        env.close()
        env.close()
        assert image.shape == (150, 200, 3)
        assert image.dtype == np.uint8
        orange, green = colours(image)
        assert 0.001 < orange < 0.1
        assert 0.0002 < green < 0.02


@pytest.mark.slow
def test_pictures():
    """By OpenGL where that works on this machine, else drawn."""
    check_pictures(rendering.backend())


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("camera", ["front", "above"])
def test_the_whole_arm_is_in_the_picture(kind, camera):
    """Places in the picture go from -1 to 1; a joint is 9 cm thick at most."""
    for sim in (ArmVectorSim.from_seeds(range(20), kind), ArmVectorSim(_ends(kind), kind)):
        for index in range(20):
            model, data = sim.models[index], sim.data[index]
            at, turn = data.camera(camera).xpos, data.camera(camera).xmat.reshape(3, 3)
            seen = (skeleton(data.qpos[None])[0] - at) @ turn
            reach = -seen[:, 2] * np.tan(np.radians(model.camera(camera).fovy[0] / 2))
            assert (np.abs(seen[:, 0]) + 0.09 < reach * 4 / 3).all()
            assert (np.abs(seen[:, 1]) + 0.09 < reach).all()


def _ends(kind):
    """Starts with the tip at the goal."""
    generator = np.random.default_rng(0)
    states = np.array([random_start(generator, kind) for _ in range(20)])
    states[:, TIP] = states[:, GOAL]
    return states


def test_the_whole_arm_is_in_the_drawing(monkeypatch):
    monkeypatch.setattr(rendering, "backend", lambda: "matplotlib")
    for camera in ("front", "above"):
        env = Arm("avoid", render_mode="rgb_array", camera=camera)
        env.reset(seed=0)
        model, data = env._sim.models[0], env._sim.data[0]
        painter = rendering.Painter(model, (320, 240), camera)
        image = painter.paint(model, data, env._sim.states[0])
        dark = (image.astype(int).sum(axis=-1) < 300) & (np.ptp(image, axis=-1) < 40)
        assert dark.mean() > 0.005
        assert not dark[[0, -1]].any()
        assert not dark[:, [0, -1]].any()


@pytest.mark.slow
def test_a_fresh_process():
    """MuJoCo is imported when a world is made; OSMesa makes pictures where it works, too.

    A process can use only one kind of OpenGL, so the second kind needs one of its own.
    """
    how = "osmesa" if rendering._works("osmesa") else rendering.backend()
    code = (
        "import sys, cotlearn.robots, cotlearn.robots.arm.definition\n"
        "assert 'mujoco' not in sys.modules\n"
        f"sys.path.insert(0, {os.path.dirname(__file__)!r})\n"
        f"from test_arm_environment import check_pictures; check_pictures({how!r})\n"
        "assert 'mujoco' in sys.modules"
    )
    environment = {**os.environ, "MUJOCO_GL": "disable" if how == "matplotlib" else how}
    environment.pop("PYOPENGL_PLATFORM", None)  # of this process
    subprocess.run([sys.executable, "-c", code], env=environment, check=True, timeout=120)


@pytest.mark.slow
def test_without_any_opengl_it_is_drawn(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(rendering, "_works", lambda name: False)
    assert rendering.backend() == "matplotlib"
    check_pictures("matplotlib")


def test_the_environment_variable_decides(monkeypatch):
    tried = []
    monkeypatch.setattr(rendering, "_works", lambda name: tried.append(name) or name == "osmesa")
    monkeypatch.setattr("platform.system", lambda: "Linux")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    assert rendering.backend() == "osmesa"
    assert tried == ["egl", "osmesa"]
    monkeypatch.setenv("MUJOCO_GL", "egl")
    assert rendering.backend() == "matplotlib"
    monkeypatch.setenv("MUJOCO_GL", "disable")
    tried.clear()
    assert rendering.backend() == "matplotlib"
    assert tried == []


def test_a_trial_that_fails_is_no_way(monkeypatch):
    rendering._works.cache_clear()
    assert not rendering._works("nothing")
    monkeypatch.setattr(rendering, "_SECONDS", 0.0)
    assert not rendering._works("never")
    rendering._works.cache_clear()


def test_an_opengl_that_cannot_be_opened_in_this_process_is_replaced(monkeypatch):
    def fail(self):
        raise ImportError("another OpenGL is in use")

    monkeypatch.setattr(rendering, "backend", lambda: "egl")
    monkeypatch.setattr(rendering.Painter, "_open", fail)
    sim = ArmVectorSim.from_seeds([0], "ring")
    model, data = sim.models[0], sim.data[0]
    painter = rendering.Painter(model, (100, 80), "front")
    assert painter.how == "matplotlib"
    assert painter.paint(model, data, sim.states[0]).shape == (80, 100, 3)
    painter.close()


def test_the_largest_picture_is_the_one_of_the_model():
    model = model_of(random_start(np.random.default_rng(0), "ring"))
    assert (model.vis.global_.offwidth, model.vis.global_.offheight) == PICTURE


def test_no_picture_without_a_mode():
    env = Arm("ring")
    env.reset(seed=0)
    assert env.render() is None


@pytest.mark.slow
def test_pictures_from_several_threads():
    """As vector environments and notebooks make them; before, EGL refused the second thread."""
    env = Arm(render_mode="rgb_array", width=64, height=48)
    env.reset(seed=0)
    first = env.render()
    with ThreadPoolExecutor(3) as pool:
        pictures = [pool.submit(env.render) for _ in range(6)]
        assert all(np.array_equal(picture.result(), first) for picture in pictures)
        pool.submit(env.close).result()
    assert np.array_equal(env.render(), first)
    env.close()


PICTURES = """
from concurrent.futures import ThreadPoolExecutor
from cotlearn.robots.arm.environment import Arm
def pictures(seed):
    env = Arm(render_mode="rgb_array", width=64, height=48)
    env.reset(seed=seed)
    found = env.render().tobytes()
    assert env._painter.how == "glfw"
    env.close()
    return found
with ThreadPoolExecutor(4) as pool:
    assert len(set(pool.map(pictures, [0] * 4))) == 1
"""


@pytest.fixture
def display():
    """An X server without a screen."""
    if not shutil.which("Xvfb"):
        pytest.skip("no Xvfb")
    told, tells = os.pipe()
    command = ["Xvfb", "-displayfd", str(tells), "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[tells], stderr=subprocess.DEVNULL)
    os.close(tells)
    with os.fdopen(told) as file:
        yield f":{file.readline().strip()}"
    server.terminate()
    server.wait()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="GLFW has windows on the main thread only")
def test_windows_of_several_threads(display):
    """Two windows that GLFW made at once ended the process."""
    environment = {**os.environ, "DISPLAY": display, "MUJOCO_GL": "glfw"}
    environment.pop("PYOPENGL_PLATFORM", None)
    trial = [sys.executable, "-c", rendering._TRIAL]
    if subprocess.run(trial, env=environment, capture_output=True, check=False).returncode:
        pytest.skip("GLFW does not work here")
    subprocess.run([sys.executable, "-c", PICTURES], env=environment, check=True, timeout=300)


def test_glfw_on_another_thread_of_other_systems(monkeypatch):
    """Outside Linux only the main thread makes and destroys windows; any can render."""

    class Window:
        alive = True

        def make_current(self):
            pass

        def free(self):
            assert threading.current_thread() is threading.main_thread()
            self.alive = False

    def opened(self):
        self._context = Window()

    monkeypatch.setattr(rendering.Painter, "_open", opened)
    monkeypatch.setattr(rendering.Painter, "_release", lambda self: None)
    monkeypatch.setattr(rendering, "backend", lambda: "glfw")
    monkeypatch.setattr(rendering.platform, "system", lambda: "Windows")
    painter = rendering.Painter(None, (64, 48), "front")
    window = painter._context
    with ThreadPoolExecutor(1) as pool:
        late = pool.submit(rendering.Painter, None, (64, 48), "front")
        with pytest.raises(RuntimeError, match=r"main thread alone.*MUJOCO_GL=disable"):
            late.result()
        pool.submit(painter.close).result()
    assert window.alive
    assert painter._context is None
    rendering.Painter(None, (64, 48), "front").close()
    assert not window.alive


@pytest.mark.parametrize("make", [Arm, PushT])
def test_nothing_moves_before_the_first_reset(make):
    env = make(render_mode="rgb_array")
    for call in (lambda: env.step(env.action_space.sample()), env.render):
        with pytest.raises(RuntimeError, match=r"call env.reset\(\) first"):
            call()
    env.close()
