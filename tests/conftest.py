import os
from itertools import islice

import numpy as np
import pytest

#: Files that take ten seconds or more.
LONG = "arrays fit gaussian isolation optimal_flow push_t push_t_expert recommendation rollout"


def pytest_configure(config):
    """With xdist, files begin in the order below, and not those of most tests first."""
    config.option.loadscopereorder = False


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
    """The server of answers, which for tests has imported what commands need, too.

    From it, processes are forked that have nothing left to import. Each worker has one.
    """
    from cotlearn.homework import isolation

    commands = ["cotlearn.cli", "cotlearn.policies.comparison.cells", "cotlearn.report", "mujoco"]
    others = ["nbformat", "pytest", "torch._dynamo"]  # the first optimizer imports the last
    isolation._PRELOAD += ["tests.quick", *commands, *others]
    return isolation._context()


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
    from cotlearn.robots.push_t import Simulation, random_state

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
    return Episodes(*arrays, name="a few", intention=intention, seed=np.array(seeds))
