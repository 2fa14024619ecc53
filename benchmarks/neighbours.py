"""How far does a look-up get: the chunk of a demonstrated window with a near observation?

No network and no training (GPI, 2510.08787). A window is drawn among the k nearest, by the distance
of the standardised observations; exploration starts choose k. Then 200 episodes from the starts of
the tables, with all demonstrations and with fewer.

    python benchmarks/neighbours.py push-t

writes data/results/neighbours_push_t.json. An interrupted run goes on.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import opened
from numpy.typing import ArrayLike
from scipy.spatial import KDTree
from torch import Tensor

from cotlearn.assets import find_data
from cotlearn.metrics import bootstrap_interval
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import read, split
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


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", choices=SETTINGS)
    parser.add_argument("--data", type=Path, help="people's demonstrations")
    parser.add_argument("--frame", help="of observations and chunks, if not that of the setting")
    asked = parser.parse_known_args()[0]
    setting = SETTINGS[asked.task]
    options = replace(setting.options, frame=asked.frame or setting.options.frame)
    episodes = read(asked.data or find_data(find_task(setting.task).demonstrations))

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        count = key["demonstrations"]
        training, _ = split(episodes, held_out=setting.held_out, train=count)
        windows = options.windows(training)
        data, task = windows.dataset(training, label=options.label), windows.task
        assert data.c is not None
        tree = KDTree(data.c.numpy())
        policies = {k: Neighbours(windows, options.execute, tree, data.x1, k) for k in NEIGHBOURS}
        tried = {k: rollout(one, episodes=TRIALS).summary() for k, one in policies.items()}
        best = max(tried, key=lambda k: (tried[k][task.strictest], tried[k][task.score]))
        done = rollout(policies[best], seeds=range(REPORTED, REPORTED + EPISODES))
        return {
            "windows": len(data),
            "k": best,
            "tried": {str(k): round(found[task.strictest], 4) for k, found in tried.items()},
            "summary": done.summary(),
            "interval": bootstrap_interval(done[task.score]),
            "success_interval": bootstrap_interval(done[task.strictest]),
        }

    name = f"neighbours_{asked.task.replace('-', '_')}"
    protocol = {"trials": TRIALS, "episodes": EPISODES}
    table = opened(__doc__ or "", protocol, parser=parser, name=name)
    most = len(episodes) - setting.held_out
    counts = [count for count in (150, 500, 1000) if count < most] + [most]
    same = {"setting": asked.task, **({"frame": asked.frame} if asked.frame else {})}
    table.fill([{**same, "demonstrations": count} for count in counts], compute)


if __name__ == "__main__":
    main()
