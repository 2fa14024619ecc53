import numpy as np
import pytest

from cotlearn.robots.episodes import Episodes
from cotlearn.robots.push_t import Simulation, random_state


@pytest.fixture(scope="session")
def episodes():
    """A few short episodes of an agent that runs through the middle of the T, with noise."""
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
