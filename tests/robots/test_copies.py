"""Copies of environments, as planners and vector environments make them, go on bit for bit."""

import copy
import pickle
import warnings

import gymnasium
import numpy as np
import pytest

import cotlearn.robots  # noqa: F401 (registers the environments)

warnings.filterwarnings("ignore", module="pymunk")
WAYS = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}


def wander(env, steps, seed):
    """What the environment says after random steps towards things to push."""
    rng, seen = np.random.default_rng(seed), []
    low, high = env.action_space.low, env.action_space.high
    action = rng.uniform(low, high).astype(np.float32)
    for step in range(steps):
        if step % 8 == 0:
            action = rng.uniform(low, high).astype(np.float32)
        seen.append(env.step(action)[0])
    return np.array(seen)


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_push_t_goes_on_bit_for_bit(way):
    """Its T was elsewhere one step later: (181, 292) in the place of (197, 250)."""
    env = gymnasium.make("cotlearn/PushT-v0").unwrapped
    env.reset(seed=0)
    before = wander(env, 20, seed=1)
    assert np.ptp(before[:, 2]) > 1  # the T was touched
    twin = WAYS[way](env)
    again = WAYS[way](twin)
    found = [wander(one, 100, seed=2) for one in (env, twin, again)]
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[0], found[2])
    assert np.ptp(found[0][:, 2]) > 1


@pytest.mark.parametrize("way", WAYS)
def test_a_copy_of_the_arm_goes_on_bit_for_bit(way):
    """There was none: "cannot pickle 'module' object"."""
    pytest.importorskip("mujoco")
    env = gymnasium.make("cotlearn/ArmAvoid-v0", render_mode="rgb_array").unwrapped
    env.reset(seed=0)
    start = env.step(env._sim.states[0][:3].astype(np.float32))[0]
    env._painter = object()  # stands for a picture's resources, which no copy shares
    twin = WAYS[way](env)
    assert twin._painter is None
    found = []
    for one in (env, twin):
        target, seen = start[:3].copy(), []
        for _ in range(15):
            target += [0.01, 0.004, 0.002]
            seen.append(one.step(target.astype(np.float32))[0])
        found.append(np.array(seen))
    assert np.array_equal(found[0], found[1])
    assert np.ptp(found[0][:, 0]) > 0.05
