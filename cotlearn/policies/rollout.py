"""Roll policies out in many worlds at once, from the same starts and with the same noise."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.couplings.base import generator_for
from cotlearn.progress import progress_bar
from cotlearn.robots.task import Array, Task, check_numbers
from cotlearn.validation import check_count

#: Seeds of starts, a million each (those of demonstrations are hashed to 32 bits): EXPLORATION to
#: try and to choose with, COUNTED to count modes from, REPORTED for nothing but the tables.
EXPLORATION, COUNTED, REPORTED = 1_000_000, 2_000_000, 3_000_000
NOISE = 13  #: keeps the noise of rollouts apart from that of training (see `generator_for`)


class Policy(Protocol):
    """What can be rolled out: `ChunkPolicy`, or anything with these."""

    windows: Any  #: has the task, and observe, the number of states in a history
    execute: int

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Noise for n rows, (draws, n, d)."""
        ...

    def act(self, history: ArrayLike, *, noise: Tensor | None = None) -> Array:
        """Actions (B, execute, A) from histories (B, observe, columns)."""
        ...


@dataclass(frozen=True)
class Rollouts:
    """What happened in E episodes.

    Attributes:
        task: what was to be done.
        seed: (E,), of the starts: `env.reset(seed=...)`.
        outcomes: name -> (E,), those of the task's worlds and of its thresholds. `rollouts[name]`
            is one of them.
        steps: (E,), until success or the time limit.
        jerk: (E,), the mean of |a_{t+1} - 2 a_t + a_{t-1}| over the actions done, in the unit of
            actions: small is smooth.
        seconds: that the policy took, in all.
        chunks: that were drawn, in all.
        states: (T + 1, E, columns) if recorded; a finished episode stands still.
    """

    task: Task
    seed: NDArray[np.int64]
    outcomes: dict[str, Array]
    steps: NDArray[np.int64]
    jerk: Array
    seconds: float
    chunks: int
    states: Array | None = None

    def __getitem__(self, outcome: str) -> Array:
        if outcome not in self.outcomes:
            raise KeyError(f"{outcome!r} is none of {', '.join(self.outcomes)}")
        return self.outcomes[outcome]

    def summary(self) -> dict[str, float]:
        """The means, for a table."""
        names = [name for name in self.outcomes if name != "mode"]
        means = {name: float(self[name].mean()) for name in names}
        return {**means, "steps": float(self.steps.mean()), "jerk": float(self.jerk.mean())}


def rollout(
    policy: Policy,
    *,
    episodes: int = 200,
    seeds: Sequence[int] | None = None,
    max_steps: int | None = None,
    record: bool = False,
    progress: bool | None = None,
) -> Rollouts:
    """Rolls a policy out, all episodes side by side.

    Start and noise of an episode depend on its seed and its number alone: two policies can be
    compared episode by episode.

    Args:
        policy: sees the last states of each world, and returns the next actions.
        episodes: how many.
        seeds: of the starts; may repeat. EXPLORATION, EXPLORATION + 1, ... if None.
        max_steps: of an episode; those of the task if None.
        record: keep all states.
        progress: show a bar; None: in terminals and notebooks.

    Raises:
        ValueError: the policy returns another shape, or actions out of range or not finite.
    """
    task = policy.windows.task
    max_steps = check_count(task.max_steps if max_steps is None else max_steps, "max_steps")
    if seeds is None:
        seeds = range(EXPLORATION, EXPLORATION + check_count(episodes, "episodes"))
    episodes = check_count(len(seeds), "seeds")
    sim = task.vector_sim(seeds)
    state = sim.states
    history = np.repeat(state[:, None], policy.windows.observe, axis=1)
    active = ~sim.finished
    steps = np.zeros(episodes, dtype=np.int64)
    done = np.full((max_steps, episodes, len(task.action)), np.nan)
    kept, seconds, chunks = [state], 0.0, 0
    with progress_bar(total=max_steps, what="rollout", show=progress) as bar:
        for now in range(max_steps):
            if not active.any():
                break
            place = now % policy.execute
            if place == 0:
                rows = np.flatnonzero(active)
                rng = generator_for(0, now // policy.execute, NOISE)
                noise = policy.noise(episodes, rng)[:, rows]
                started = time.perf_counter()
                plan = np.zeros((episodes, policy.execute, len(task.action)))
                plan[rows] = check_numbers(
                    policy.act(history[rows], noise=noise),
                    task.action_limits,
                    "actions of the policy",
                    shape=(len(rows), policy.execute, len(task.action)),
                )
                seconds += time.perf_counter() - started
                chunks += len(rows)
            action = plan[:, place]
            sim.step(action, active=active)
            done[now, active] = action[active]
            steps[active] += 1
            state = sim.states
            history = np.concatenate([history[:, 1:], state[:, None]], axis=1)
            active = active & ~sim.finished
            if record:
                kept.append(state)
            bar.update()
    return Rollouts(
        task=task,
        seed=np.asarray(seeds, dtype=np.int64),
        outcomes=with_thresholds(task, sim.outcomes()),
        steps=steps,
        jerk=_jerk(done, steps),
        seconds=seconds,
        chunks=chunks,
        states=np.array(kept) if record else None,
    )


def with_thresholds(task: Task, found: dict[str, Array]) -> dict[str, Array]:
    """Outcomes of the worlds, and those that follow from them by the task's thresholds."""
    passed = {
        name: (found[of] > threshold).astype(np.float64)
        for name, (of, threshold) in task.thresholds.items()
    }
    return {**found, **passed}


def _jerk(done: Array, steps: NDArray[np.int64]) -> Array:
    """The mean second difference of each episode's actions; 0 for fewer than three."""
    second = np.linalg.norm(np.diff(done, n=2, axis=0), axis=2)  # NaN after the end
    return np.nansum(second, axis=0) / np.maximum(steps - 2, 1)
