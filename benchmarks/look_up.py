"""How far does a look-up get: the chunk of a demonstrated window with a near observation?

No network and no training (GPI, 2510.08787). A window is drawn among the k nearest, by the distance
of the standardised observations; exploration starts choose k. Then 200 episodes from the starts of
the tables, with all demonstrations and with fewer.

    python benchmarks/look_up.py push-t

adds rows to data/results/study.csv, in the place of those that are there. And is a trained policy
a look-up, too? Which way does it take from the starts of its training, and from new ones?

    cotlearn bench arm-ring behaviour_cloning --tables mine --weights mine
    python benchmarks/look_up.py arm-ring --policy mine/behaviour_cloning-0.safetensors
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from cells import RESULTS
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from torch import Tensor

from cotlearn.course.assets import find_data
from cotlearn.policies.bench import STUDY_KEY, Row, append, means
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.policies.settings import SETTINGS, Setting
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes, read, split
from cotlearn.robots.registry import find_task
from cotlearn.robots.task import Array

NEIGHBOURS, TRIALS, EPISODES = (1, 4, 16), 100, 200


@dataclass
class Neighbours:
    """A policy that acts as a demonstrated window with a near observation says."""

    windows: Windows
    execute: int
    tree: KDTree
    chunks: Tensor
    k: int

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """One number for each row, which chooses among the neighbours."""
        return torch.rand(1, n, 1, generator=generator)

    def act(self, history: ArrayLike, *, noise: Tensor | None = None) -> Array:
        """The first actions of the chosen chunks."""
        assert noise is not None
        history = np.asarray(history)
        c = self.windows.condition(history).numpy()
        near = np.asarray(self.tree.query(c, k=[*range(1, self.k + 1)])[1])
        rank = (noise[0, :, 0] * self.k).long().clamp(max=self.k - 1).numpy()
        chosen = self.chunks[near[np.arange(len(near)), rank]]
        actions = self.windows.actions(chosen, history)
        return actions.clip(*self.windows.task.action_limits)[:, : self.execute]


def look_up(setting: Setting, episodes: Episodes, count: int, frame: str | None) -> Row:
    """The row of a look-up in some demonstrations."""
    options = replace(setting.options, frame=frame or setting.options.frame)
    training, _ = split(episodes, held_out=setting.held_out, train=count)
    windows = options.windows(training)
    data, task = windows.dataset(training, label=options.label), windows.task
    assert data.c is not None
    tree = KDTree(data.c.numpy())
    policies = {k: Neighbours(windows, options.execute, tree, data.x1, k) for k in NEIGHBOURS}
    tried = {k: rollout(one, episodes=TRIALS).summary() for k, one in policies.items()}
    best = max(tried, key=lambda k: (tried[k][task.strictest], tried[k][task.score]))
    done = rollout(policies[best], seeds=range(REPORTED, REPORTED + EPISODES))
    shares = ", ".join(f"{k}: {found[task.strictest]:g}" for k, found in tried.items())
    return {
        "source": "look_up",
        "task": setting.table,
        "regime": setting.regime,
        "method": "look_up",
        "frame": windows.frame,
        "demonstrations": count,
        "setting": "as trained",
        "evaluations": 0,
        "start": "none",
        "starts": REPORTED,
        "episodes": EPISODES,
        **means(done),
        "note": f"k={best}, of {shares} on exploration starts",
    }


def by_heart(policy: ChunkPolicy, training: Episodes) -> None:
    """Prints how often a policy goes the way of the nearest demonstration, by its start."""
    windows, task = policy.windows, policy.windows.task
    assert training.seed is not None
    assert training.mode is not None

    def seen(states: Array) -> Array:
        return windows.condition(np.repeat(states[:, None], windows.observe, axis=1)).numpy()

    tree = KDTree(seen(training.state[training.starts]))
    known = np.random.default_rng(0).choice(training.seed, EPISODES, replace=False)
    starts = {"training": known, "new": np.arange(REPORTED, REPORTED + EPISODES)}
    for name, seeds in starts.items():
        done = rollout(policy, seeds=seeds.tolist(), max_steps=task.mode_steps)
        near = tree.query(seen(task.vector_sim(seeds.tolist()).states))[1]
        near, took = training.mode[near], done["mode"]
        passed = took >= 0
        share = (took == near)[passed].mean()
        print(f"{name} starts: success {done['success'].mean():.3f}", end=", ")
        print(f"the way of the nearest demonstration in {share:.0%} of {passed.sum()} passes")


def main() -> None:
    """Adds the rows of a task, or looks at a policy."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", choices=SETTINGS)
    parser.add_argument("--data", type=Path, help="people's demonstrations")
    parser.add_argument("--frame", help="of observations and chunks, if not that of the setting")
    parser.add_argument("--policy", type=Path, help="of a task with ways, that plans once")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    setting = SETTINGS[asked.task]
    episodes = read(asked.data or find_data(find_task(setting.task).demonstrations))
    if asked.policy and episodes.mode is None:
        parser.error(f"--policy needs a task with ways, arm-ring or arm-avoid, got {asked.task}")
    if asked.policy:
        training, _ = split(episodes, held_out=setting.held_out)
        return by_heart(ChunkPolicy.load(asked.policy), training)
    most = len(episodes) - setting.held_out
    for count in [*(count for count in (150, 500, 1000) if count < most), most]:
        row = look_up(setting, episodes, count, asked.frame)
        append(RESULTS / "study.csv", [row], STUDY_KEY)
        print(f"{count} demonstrations: success {row['success']:.3f}")


if __name__ == "__main__":
    main()
