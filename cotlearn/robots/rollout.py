"""Roll policies out in many worlds at once, from the same starts and with the same noise."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.couplings.base import generator_for
from cotlearn.progress import progress_bar
from cotlearn.robots.episodes.checked import Array
from cotlearn.robots.push_t import MAX_STEPS, SUCCESS, Simulations, random_state
from cotlearn.robots.push_t.simulation import checked
from cotlearn.validation import check_count

FRESH = 1_000_000  #: seeds from here on are for evaluation (demonstrations' are hashed, 32 bits)
NOISE = 13  #: keeps the noise of rollouts apart from that of training (see `generator_for`)


class Policy(Protocol):
    """What can be rolled out: `ChunkPolicy`, or anything with these three."""

    execute: int

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Noise for n rows, (draws, n, d)."""
        ...

    def act(self, history: ArrayLike, *, noise: Tensor | None = None) -> Array:
        """Actions (B, execute, 2) from histories (B, observe, 5)."""
        ...


@dataclass(frozen=True)
class Rollouts:
    """What happened in E episodes.

    Attributes:
        seed: (E,), of the starts: `env.reset(seed=...)`.
        coverage: (E,), best coverage at any time; the score of Diffusion Policy is
            min(1, coverage / 0.95).
        last: (E,), coverage at the end.
        steps: (E,), until success or the time limit.
        jerk: (E,), the mean of |a_{t+1} - 2 a_t + a_{t-1}| over the actions done, pixels: small
            is smooth.
        seconds: that the policy took, in all.
        chunks: that were drawn, in all.
        states: (T + 1, E, 5) if recorded; a finished episode stands still.
    """

    seed: NDArray[np.int64]
    coverage: Array
    last: Array
    steps: NDArray[np.int64]
    jerk: Array
    seconds: float
    chunks: int
    states: Array | None = None

    def __len__(self) -> int:
        return len(self.seed)

    def success(self, threshold: float = SUCCESS) -> NDArray[np.bool_]:
        """(E,), whether the best coverage was above the threshold."""
        return self.coverage > threshold

    def summary(self) -> dict[str, float]:
        """The means, for a table."""
        return {
            "coverage": float(self.coverage.mean()),
            "success_90": float(self.success(0.90).mean()),
            "success_95": float(self.success(SUCCESS).mean()),
            "steps": float(self.steps.mean()),
            "jerk": float(self.jerk.mean()),
        }


def starts(episodes: int, first: int = FRESH) -> Array:
    """The states (episodes, 5) of the seeds first, first + 1, ..."""
    seeds = range(first, first + check_count(episodes, "episodes"))
    return np.array([random_state(np.random.default_rng(seed)) for seed in seeds])


def rollout(
    policy: Policy,
    *,
    episodes: int = 200,
    first_seed: int = FRESH,
    noise_seed: int = 0,
    max_steps: int = MAX_STEPS,
    record: bool = False,
    progress: bool | None = None,
) -> Rollouts:
    """Rolls a policy out, all episodes side by side.

    Start and noise of an episode depend on its number, `first_seed` and `noise_seed` alone: two
    policies can be compared episode by episode.

    Args:
        policy: sees the last states of each world, and returns the next actions.
        episodes: how many.
        first_seed: of the starts.
        noise_seed: of the policy's noise.
        max_steps: of an episode.
        record: keep all states.
        progress: show a bar; None: in terminals and notebooks.

    Raises:
        ValueError: the policy returns another shape, or actions out of range or not finite.
    """
    check_count(max_steps, "max_steps")
    worlds = Simulations(starts(episodes, check_count(first_seed, "first_seed", minimum=0)))
    state, best = worlds.states, worlds.coverage
    history = np.repeat(state[:, None], _observed(policy), axis=1)
    active = best <= SUCCESS
    steps = np.zeros(episodes, dtype=np.int64)
    done = np.full((max_steps, episodes, 2), np.nan)
    kept, seconds, chunks = [state], 0.0, 0
    with progress_bar(total=max_steps, what="rollout", show=progress) as bar:
        for now in range(max_steps):
            if not active.any():
                break
            place = now % policy.execute
            if place == 0:
                rows = np.flatnonzero(active)
                rng = generator_for(noise_seed, now // policy.execute, NOISE)
                noise = policy.noise(episodes, rng)[:, rows]
                started = time.perf_counter()
                plan = np.zeros((episodes, policy.execute, 2))
                plan[rows] = _checked(policy.act(history[rows], noise=noise), policy, len(rows))
                seconds += time.perf_counter() - started
                chunks += len(rows)
            action = plan[:, place]
            worlds.step(action, active=active)
            done[now, active] = action[active]
            steps[active] += 1
            state = worlds.states
            history = np.concatenate([history[:, 1:], state[:, None]], axis=1)
            best = np.maximum(best, worlds.coverage)
            active = active & (best <= SUCCESS)
            if record:
                kept.append(state)
            bar.update()
    return Rollouts(
        seed=np.arange(first_seed, first_seed + episodes),
        coverage=best,
        last=worlds.coverage,
        steps=steps,
        jerk=_jerk(done, steps),
        seconds=seconds,
        chunks=chunks,
        states=np.array(kept) if record else None,
    )


def _observed(policy: Any) -> int:
    return int(policy.windows.observe) if hasattr(policy, "windows") else int(policy.observe)


def _checked(actions: Any, policy: Policy, rows: int) -> Array:
    array = np.asarray(actions)
    if array.shape != (rows, policy.execute, 2):
        raise ValueError(
            f"the policy must return actions of shape {(rows, policy.execute, 2)}, got "
            f"{array.shape}"
        )
    return checked(array, "actions of the policy")


def _jerk(done: Array, steps: NDArray[np.int64]) -> Array:
    """The mean second difference of each episode's actions; 0 for fewer than three."""
    if len(done) < 3:
        return np.zeros(len(steps))
    second = np.linalg.norm(np.diff(done, n=2, axis=0), axis=2)  # NaN after the end
    return np.nansum(second, axis=0) / np.maximum(steps - 2, 1)
