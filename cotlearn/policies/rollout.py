"""Rollouts of policies in many simulations at once, from the same starts and the same noise."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.interrupt import interrupt_between_steps
from cotlearn.progress import progress_bar
from cotlearn.randomness import Purpose, generator_for
from cotlearn.robots.task import Array, Task, check_numbers
from cotlearn.validation import check_count, check_has, check_seeds

#: First seeds of starts, a million seeds each (demonstrations have hashed 32-bit seeds):
#: EXPLORATION for trying and choosing, COUNTED for counting modes, REPORTED for the tables only.
EXPLORATION, COUNTED, REPORTED = 1_000_000, 2_000_000, 3_000_000


class Policy(Protocol):
    """The interface of policies for `rollout`; `ChunkPolicy` implements it."""

    windows: Any  #: has `task`, and `observe`, the number of states in a history
    execute: int  #: steps of a chunk to execute

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Draw noise for n rows, (draws, n, d)."""

    def act(self, history: ArrayLike, *, noise: Tensor | None = None) -> Array:
        """Actions (B, execute, A) from histories (B, observe, columns)."""


@dataclass(frozen=True)
class Rollouts:
    """The results of E episodes.

    Attributes:
        task: the task.
        seed: (E,), seeds of the starts, as in `env.reset(seed=...)`.
        outcomes: name -> (E,), outcomes of the simulations and of the task's thresholds;
            `rollouts[name]` looks one up.
        steps: (E,), control steps until the episode ended.
        jerk: (E,), mean of |a_{t+1} - 2 a_t + a_{t-1}| over the executed actions, in the unit of
            actions; small values are smooth.
        seconds: total time that the policy took.
        chunks: total number of sampled chunks.
        states: (T + 1, E, columns), or None if not recorded; a finished episode stands still.
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
            raise KeyError(f"outcome must be one of {', '.join(self.outcomes)}; got {outcome!r}")
        return self.outcomes[outcome]

    def summary(self) -> dict[str, float]:
        """Means over episodes: all outcomes but "mode", steps and jerk."""
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
    """Roll out a policy in all episodes in parallel.

    The start of an episode depends only on its seed, and its noise only on its number, so that two
    policies can be compared episode by episode. (What DDPM draws later in its chain depends on how
    many are rolled out, too.)

    Args:
        policy: maps the last states of each simulation to the next actions.
        episodes: number of episodes if seeds is None.
        seeds: of the starts, may repeat; EXPLORATION, EXPLORATION + 1, ... if None.
        max_steps: time limit of an episode in control steps; the task's limit if None.
        record: keep all states.
        progress: show a progress bar; if None, in terminals and notebooks.

    Raises:
        ValueError: the policy's actions have a wrong shape, are out of range or not finite.
        KeyboardInterrupt: Ctrl-C was pressed.
    """
    check_has(policy, "policy", "a policy such as ChunkPolicy", "windows", "execute", "act")
    check_count(policy.execute, "policy.execute")
    task = policy.windows.task
    max_steps = check_count(task.max_steps if max_steps is None else max_steps, "max_steps")
    if seeds is None:
        seeds = range(EXPLORATION, EXPLORATION + check_count(episodes, "episodes"))
    seeds = check_seeds(seeds)
    episodes = len(seeds)
    sim = task.vector_sim(seeds)
    state = sim.states
    history = np.repeat(state[:, None], policy.windows.observe, axis=1)
    active = ~sim.finished
    steps = np.zeros(episodes, dtype=np.int64)
    done = np.full((max_steps, episodes, len(task.action)), np.nan)
    kept, seconds, chunks, early = [state], 0.0, 0, None
    limits, size = task.action_limits, (policy.execute, len(task.action))
    with (
        progress_bar(total=max_steps, what="rollout", show=progress) as bar,
        interrupt_between_steps() as stop,
    ):
        for now in range(max_steps):
            if stop.is_set() or not active.any():
                break
            place = now % policy.execute
            if place == 0:
                rows = np.flatnonzero(active)
                rng = generator_for(0, now // policy.execute, Purpose.ROLLOUT)
                noise = policy.noise(episodes, rng)[:, rows]
                started = time.perf_counter()
                plan = np.zeros((episodes, *size))
                acts, name = policy.act(history[rows], noise=noise), "actions of the policy"
                plan[rows] = check_numbers(acts, limits, name, shape=(len(rows), *size))
                seconds += time.perf_counter() - started
                chunks += len(rows)
            action = plan[:, place]
            sim.step(action, active=active)
            if now + 1 == task.early_steps:
                early = sim.outcomes()[task.score]
            done[now, active] = action[active]
            steps[active] += 1
            state = sim.states
            history = np.concatenate([history[:, 1:], state[:, None]], axis=1)
            active = active & ~sim.finished
            if record:
                kept.append(state)
            bar.update()
    outcomes = sim.outcomes()
    if task.early_steps:
        then = outcomes[task.score] if early is None else early
        outcomes[f"{task.score}_{task.early_steps}"] = then
    return Rollouts(
        task=task,
        seed=np.asarray(seeds, dtype=np.int64),
        outcomes=with_derived(task, outcomes),
        steps=steps,
        jerk=_jerk(done, steps),
        seconds=seconds,
        chunks=chunks,
        states=np.array(kept) if record else None,
    )


def with_derived(task: Task, found: dict[str, Array]) -> dict[str, Array]:
    """Add to `found` the outcomes that the task derives from others: thresholds and ratios."""
    derived = dict(found)
    for name, (of, threshold) in task.thresholds.items():
        derived[name] = (found[of] > threshold).astype(np.float64)
    for name, (of, full) in task.capped.items():
        derived[name] = np.minimum(found[of] / full, 1.0)
    return derived


def _jerk(done: Array, steps: NDArray[np.int64]) -> Array:
    """Mean norm of the second differences of each episode's actions; 0 for fewer than three."""
    second = np.linalg.norm(np.diff(done, n=2, axis=0), axis=2)  # NaN after the end
    return np.nansum(second, axis=0) / np.maximum(steps - 2, 1)
