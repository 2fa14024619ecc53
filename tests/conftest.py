import os
from itertools import islice

import numpy as np
import pytest


def pytest_collection_modifyitems(items):
    """Notebooks first, then files with slow tests: what is long must not begin at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path.suffix != ".ipynb", item.path not in slow))


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
    return Episodes(
        np.array(states),
        np.array(actions),
        np.array(ends),
        name="a few",
        intention=intention,
        seed=np.array(seeds),
    )
