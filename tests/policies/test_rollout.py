from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
import torch

import cotlearn.robots  # noqa: F401  (registers the environment)
from cotlearn.course.assets import find_data
from cotlearn.policies.rollout import COUNTED, EXPLORATION, REPORTED, rollout
from cotlearn.robots.episodes import read
from cotlearn.robots.push_t import GOAL, PushTVectorSim
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.registry import TASKS, find_task

ROOT = Path(__file__).resolve().parents[2]
SEEDS = (EXPLORATION, COUNTED, REPORTED)


class Wander:
    """Goes to random places; remembers who was asked."""

    execute = 4

    def __init__(self, scale=100.0, starts=None, act=None):
        self.scale, self.act_instead, self.asked, task = scale, act, [], PUSH_T
        if starts:
            task = replace(task, vector_sim=lambda seeds: PushTVectorSim(starts))
        self.windows = SimpleNamespace(task=task, observe=2)

    def noise(self, n, generator=None):
        return torch.randn(1, n, 8, generator=generator)

    def act(self, history, *, noise=None):
        self.asked.append(len(history))
        if self.act_instead:
            return self.act_instead(history)
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
    assert np.array_equal(many["coverage"], again["coverage"])
    first = range(EXPLORATION, EXPLORATION + 3)
    fewer = rollout(Wander(), seeds=first, max_steps=24, progress=False)
    assert np.array_equal(many["coverage"][:3], fewer["coverage"])
    assert (len(many.seed), many.seed[0]) == (5, EXPLORATION)


def test_success_ends_an_episode_and_nobody_asks_for_it_again():
    starts = [[50.0, 50.0, *GOAL], [100.0, 100.0, 300.0, 300.0, 0.0]]  # one is at its goal already
    policy = Wander(scale=0.0, starts=starts)
    done = rollout(policy, episodes=2, max_steps=8, progress=False)
    assert done.steps.tolist() == [0, 8]
    assert done["coverage"][0] > 0.99
    assert done["success_95"].tolist() == [1, 0]
    assert policy.asked == [1, 1]
    assert done.jerk.tolist() == [0, 0]
    assert done.summary()["success_95"] == 0.5
    assert "mode" not in done.summary()
    known = "outcome must be one of coverage, last, mode, coverage_200, succ"
    with pytest.raises(KeyError, match=known):
        done["speed"]


def test_the_side_that_is_pushed_first():
    # an upright T below the agent, and one far away from it
    starts = [[256.0, 100.0, 256, 200, 0.0], [256.0, 100.0, 400, 200, 0.0]]
    down = Wander(starts=starts, act=lambda h: np.tile([256.0, 400.0], (len(h), 4, 1)))
    done = rollout(down, episodes=2, max_steps=10, progress=False)
    assert done["mode"].tolist() == [0, -1]  # the outer edge of the bar; nothing


def test_repeated_seeds_start_alike_and_have_noise_of_their_own():
    done = rollout(Wander(), seeds=[3, 3, 4], max_steps=4, record=True, progress=False)
    assert done.seed.tolist() == [3, 3, 4]
    assert np.array_equal(done.states[0, 0], done.states[0, 1])
    assert not np.array_equal(done.states[-1, 0], done.states[-1, 1])


def test_jerk_by_hand():
    zigzag = Wander(act=lambda h: np.tile([[100.0, 100.0], [110.0, 100.0]], (len(h), 2, 1)))
    for steps, jerk in ((12, 20), (2, 0)):
        done = rollout(zigzag, episodes=2, max_steps=steps, progress=False)
        assert done.jerk.tolist() == [jerk, jerk]


@pytest.mark.parametrize(
    ("actions", "error", "message"),
    [
        (np.zeros((2, 3, 2)), ValueError, r"have shape \(2, 4, 2\), got \(2, 3, 2\)"),
        (np.full((2, 4, 2), np.nan), ValueError, "be finite"),
        (np.full((2, 4, 2), 600.0), ValueError, r"lie between \[0.0, 0.0\] and \[512.0, 512.0\]"),
        (np.full((2, 4, 2), "left"), TypeError, "hold real numbers"),
    ],
)
def test_bad_policies(actions, error, message):
    with pytest.raises(error, match=f"actions of the policy must {message}"):
        rollout(Wander(act=lambda history: actions), episodes=2, progress=False)


@pytest.mark.parametrize("option", ["episodes", "max_steps"])
def test_bad_options(option):
    with pytest.raises(ValueError, match=f"{option} must be at least 1"):
        rollout(Wander(), **{option: 0}, progress=False)


def test_the_scores_of_the_literature():
    def push(task, max_steps):
        policy = Wander(act=lambda h: h[:, -1:, 2:4].repeat(4, axis=1).clip(0, 512))  # to the T
        policy.windows.task = replace(PUSH_T, **task)
        return rollout(policy, episodes=20, max_steps=max_steps, progress=False)

    ratios = {"reward": ("coverage", 0.95), "reward_20": ("coverage_20", 0.3)}
    long = push({"early_steps": 20, "capped": ratios, "thresholds": {}}, 60)
    short = push({}, 20)
    assert np.array_equal(long["coverage_20"], short["coverage"])
    assert np.array_equal(short["coverage_200"], short["coverage"])  # the episode ended before
    assert (long["coverage"] > long["coverage_20"]).any()
    assert np.allclose(long["reward"], long["coverage"] / 0.95)
    assert (long["reward_20"] == 1).any()
    assert np.allclose(long["reward_20"], (long["coverage_20"] / 0.3).clip(max=1))


@pytest.mark.slow
@pytest.mark.parametrize("name", [task.name for task in TASKS.values() if task.demonstrations])
def test_no_start_serves_twice(name):
    """Starts to explore with, to count modes from, to report and to learn from are different."""
    task, n = find_task(name), 100
    starts = {first: task.vector_sim(range(first, first + n)).states for first in SEEDS}
    shown = read(find_data(task.demonstrations))
    starts[0] = shown.state[[0, *shown.ends[:-1]]]
    every = np.concatenate(list(starts.values())).round(3)
    assert len(np.unique(every, axis=0)) == len(every)


def test_only_tables_report():
    tables = {"cotlearn": {"rollout.py", "bench.py"}, "benchmarks": {"look_up.py", "in_lerobot.py"}}
    for folder, names in tables.items():
        paths = (ROOT / folder).rglob("*.py")
        assert {path.name for path in paths if "REPORTED" in path.read_text("utf-8")} == names


def test_a_policy_that_executes_nothing_is_refused():
    policy = Wander()
    policy.execute = 0
    with pytest.raises(ValueError, match=r"policy.execute must be at least 1, got 0"):
        rollout(policy, episodes=1, max_steps=4, progress=False)
