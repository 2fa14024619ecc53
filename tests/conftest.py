import multiprocessing
import os
import shutil
import signal
from itertools import islice

import numpy as np
import pytest

#: Files that take ten seconds or more.
LONG = "arrays fit gaussian inside optimal_flow push_t push_t_expert recommendation rollout"


def pytest_configure(config):
    """With xdist, files begin in the order below; Ctrl-C works for the tests that send it."""
    config.option.loadscopereorder = False
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # started in a shell's background
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """Notebooks, then files with slow tests, then long ones: nothing long begins at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    long = {item.path for item in items if item.path.stem.removeprefix("test_") in LONG.split()}
    items.sort(key=lambda i: (i.path.suffix != ".ipynb", i.path not in slow, i.path not in long))


def pytest_terminal_summary(terminalreporter):
    """Tells how long each notebook took, and which parts of `make test` failed before."""
    seconds = {}
    for report in (r for reports in terminalreporter.stats.values() for r in reports):
        path = getattr(report, "nodeid", "").partition("::")[0]
        if path.endswith(".ipynb"):
            seconds[path] = seconds.get(path, 0) + getattr(report, "duration", 0)
    if seconds:
        terminalreporter.section("notebooks, seconds")
    for path, total in sorted(seconds.items()):
        terminalreporter.line(f"{path:<60} {total:7.1f}")
    if os.environ.get("COTLEARN_FAILED"):
        terminalreporter.section(f"FAILED before: {os.environ['COTLEARN_FAILED']}", red=True)


@pytest.fixture(scope="session")
def warm():
    """A server that has imported what commands need; processes forked from it start at once."""
    context = multiprocessing.get_context("forkserver")
    commands = ["cotlearn.cli", "cotlearn.course.grading", "cotlearn.policies.bench"]
    others = ["cotlearn.report", "mujoco", "pytest", "torch._dynamo"]  # the last by an optimizer
    context.set_forkserver_preload(["tests.quick", "tests.forked", *commands, *others])
    return context


@pytest.fixture(scope="session")
def browser():
    """The system's Chromium."""
    api = pytest.importorskip("playwright.sync_api", reason="needs the package playwright")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium on this machine: its pages were not tried in a browser")
    with api.sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


@pytest.fixture
def two_candidates(monkeypatch):
    """`recommend` compares two couplings only, where it is not its choice that is tested."""
    from cotlearn.diagnostics import recommendation

    of_all = recommendation.candidates
    monkeypatch.setattr(
        recommendation, "candidates", lambda x1, c: dict(islice(of_all(x1, c).items(), 2))
    )


@pytest.fixture(scope="session")
def episodes():
    """A few short episodes of an agent that runs through the middle of the T, with noise."""
    from cotlearn.robots.episodes import Episodes
    from cotlearn.robots.push_t import PUSH_T, Simulation, random_state

    rng = np.random.default_rng(0)
    states, actions, ends, seeds = [], [], [], []
    for seed in range(12):
        world = Simulation(random_state(np.random.default_rng(seed)))
        for _ in range(int(rng.integers(20, 40))):
            state = world.state
            action = np.clip(state[2:4] + rng.normal(0, 60, 2), 0, 512)
            states.append(state)
            actions.append(action)
            world.step(*action)
        ends.append(len(states))
        seeds.append(seed)
    noise = rng.normal(0, 5, (len(actions), 2))
    intention = np.clip(np.array(actions) + noise, 0, 512)
    arrays = map(np.array, (states, actions, ends))
    return Episodes(*arrays, PUSH_T, name="a few", intention=intention, seed=np.array(seeds))
