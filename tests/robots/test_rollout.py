import gymnasium
import numpy as np
import pytest
import torch

import cotlearn.robots  # noqa: F401  (registers the environment)
from cotlearn.robots.push_t import GOAL
from cotlearn.robots.rollout import FRESH, rollout, starts


class Wander:
    """Goes to random places; remembers who was asked."""

    observe, execute = 2, 4

    def __init__(self, scale=100.0):
        self.scale, self.asked = scale, []

    def noise(self, n, generator=None):
        return torch.randn(1, n, 8, generator=generator)

    def act(self, history, *, noise=None):
        self.asked.append(len(history))
        return (256 + self.scale * noise[0].numpy().reshape(-1, 4, 2)).clip(0, 512)


def test_against_the_gymnasium_environment():
    done = rollout(Wander(), episodes=3, max_steps=40, record=True, progress=False)
    env = gymnasium.make("cotlearn/PushT-v0").unwrapped
    for index, seed in enumerate(done.seed.tolist()):
        state, _ = env.reset(seed=seed)
        assert np.allclose(state[:4], done.states[0, index, :4], atol=1e-3)
    assert done.states.shape == (41, 3, 5)
    assert done.steps.tolist() == [40] * 3
    assert done.chunks == 30
    assert done.seconds > 0


def test_episodes_are_paired():
    many = rollout(Wander(), episodes=5, max_steps=24, progress=False)
    again = rollout(Wander(), episodes=5, max_steps=24, progress=False)
    assert np.array_equal(many.coverage, again.coverage)
    other = rollout(Wander(), episodes=5, max_steps=24, noise_seed=1, progress=False)
    assert not np.array_equal(many.jerk, other.jerk)
    assert len(many) == 5
    assert many.seed[0] == FRESH


def test_success_ends_an_episode_and_nobody_asks_for_it_again(monkeypatch):
    from cotlearn.robots import rollout as module

    def some_are_there(episodes, first):
        states = np.array([[50.0, 50.0, *GOAL], [100.0, 100.0, 300.0, 300.0, 0.0]])
        return states[:episodes]

    monkeypatch.setattr(module, "starts", some_are_there)
    policy = Wander(scale=0.0)
    done = rollout(policy, episodes=2, max_steps=8, progress=False)
    assert done.steps.tolist() == [0, 8]
    assert done.coverage[0] > 0.99
    assert done.success().tolist() == [True, False]
    assert done.success(0.0).tolist() == [True, True]
    assert policy.asked == [1, 1]
    assert done.jerk.tolist() == [0, 0]
    assert done.summary()["success_95"] == 0.5


def test_jerk_by_hand():
    class Zigzag(Wander):
        def act(self, history, *, noise=None):
            return np.tile([[100.0, 100.0], [110.0, 100.0]], (len(history), 2, 1))

    assert rollout(Zigzag(), episodes=2, max_steps=12, progress=False).jerk.tolist() == [20, 20]
    assert rollout(Zigzag(), episodes=2, max_steps=2, progress=False).jerk.tolist() == [0, 0]


def test_starts_are_those_of_the_environment():
    env = gymnasium.make("cotlearn/PushT-v0", obs_type="state").unwrapped
    state, _ = env.reset(seed=7)
    assert np.allclose(starts(2, first=6)[1][:2], state[:2], atol=1e-3)


@pytest.mark.parametrize(
    ("actions", "error", "message"),
    [
        (np.zeros((2, 3, 2)), ValueError, r"actions of shape \(2, 4, 2\), got \(2, 3, 2\)"),
        (np.full((2, 4, 2), np.nan), ValueError, "actions of the policy must be finite"),
        (np.full((2, 4, 2), 600.0), ValueError, r"actions of the policy must lie in \[0, 512\]"),
        (np.full((2, 4, 2), "left"), TypeError, "actions of the policy must be real numbers"),
    ],
)
def test_bad_policies(actions, error, message):
    class Bad(Wander):
        def act(self, history, *, noise=None):
            return actions

    with pytest.raises(error, match=message):
        rollout(Bad(), episodes=2, progress=False)


@pytest.mark.parametrize("option", ["episodes", "max_steps"])
def test_bad_options(option):
    with pytest.raises(ValueError, match=f"{option} must be at least 1"):
        rollout(Wander(), **{option: 0}, progress=False)
