"""Rollouts of a policy as the panel *robots* replays them: states, chunks and outcomes."""

from __future__ import annotations

import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from cotlearn.course.assets import find_data
from cotlearn.play.packing import numbers
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import Rollouts, rollout
from cotlearn.robots.arm import constants as arm
from cotlearn.robots.arm.drawing import GOAL_MARK, PILLAR
from cotlearn.robots.push_t import constants as push_t
from cotlearn.robots.task import Array, Task
from cotlearn.validation import check_choice

FILE = "results/playground_replays.json.gz"
TASKS = ("push-t", "arm-ring")  #: that can be drawn
SCALE = {"push-t": 32.0, "arm-ring": 8192.0}  #: stored integers in a pixel, or in a metre
TURN = 8192.0  #: stored integers in a radian


class Watched:
    """A policy that remembers its chunks; everything else is the policy's own."""

    def __init__(self, policy: ChunkPolicy) -> None:
        self.policy = policy
        self.windows, self.execute = policy.windows, policy.execute
        self.chunks: list[Array] = []

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """The policy's noise."""
        return self.policy.noise(n, generator)

    def act(self, history: ArrayLike, *, noise: Tensor | None = None) -> Array:
        """The policy's actions; the whole chunk is kept."""
        chunk = self.policy.chunk(history, noise=noise)
        self.chunks.append(chunk)
        return chunk[:, : self.execute]


def drawable(task: Task) -> str:
    """The name of a task that the panel can draw.

    Raises:
        ValueError: it cannot.
    """
    return check_choice(task.name, "task of the policy", TASKS)


def record(
    policy: ChunkPolicy,
    seeds: Sequence[int],
    *,
    with_chunks: bool = True,
    progress: bool | None = False,
) -> dict[str, Any]:
    """Roll a policy out, and pack what happened.

    Args:
        policy: of one of `TASKS`.
        seeds: of the starts; they may repeat, the noise differs.
        with_chunks: keep the planned actions, to draw them.
        progress: show a progress bar; if None, in terminals and notebooks.

    Returns:
        `states` and `chunks` as packed integers, their shapes and what became of each episode.

    Raises:
        ValueError: the policy is of another task.
    """
    name = drawable(policy.windows.task)
    watched = Watched(policy)
    found = rollout(watched, seeds=seeds, record=True, progress=progress)
    assert found.states is not None
    states = found.states.swapaxes(0, 1)[:, : found.steps.max() + 1]
    chunks = _chunks_of(watched, found)[:, : None if with_chunks else 0]
    return {
        "states": numbers(scaled(states, name), "<i2"),
        "shape": list(states.shape),
        "chunks": numbers(chunks * SCALE[name], "<i2"),
        "chunkShape": list(chunks.shape),
        "execute": policy.execute,
        "steps": found.steps.tolist(),
        "outcomes": [outcome(found, e) for e in range(len(seeds))],
    }


def _chunks_of(watched: Watched, found: Rollouts) -> Array:
    """The chunks (E, chunks, predict, A); zeros after an episode's end."""
    shape = watched.chunks[0].shape[1:]
    chunks = np.zeros((len(found.steps), len(watched.chunks), *shape))
    for number, some in enumerate(watched.chunks):  # made for the episodes that still went on
        chunks[found.steps > number * watched.execute, number] = some
    return chunks


def scaled(states: Array, name: str) -> Array:
    """States (..., columns) in the units of the file; angles are reduced to one turn."""
    whole = states * SCALE[name]
    if name == "push-t":
        angle = states[..., 4]
        whole[..., 4] = TURN * np.arctan2(np.sin(angle), np.cos(angle))
    return whole


def outcome(found: Rollouts, episode: int) -> dict[str, Any]:
    """How an episode ended: whether well, and in words."""
    if found.task.name == "push-t":
        coverage = float(found["coverage"][episode])
        good = coverage > push_t.SUCCESS
        return {"good": good, "words": f"best: {coverage:.0%} covered", "mode": -1}
    good = bool(found["success"][episode])
    mode = int(found["mode"][episode])
    hit = bool(found["collision"][episode])
    words = arm.MODES["ring"][mode] if good else "hits the pillar" if hit else "misses the goal"
    return {"good": good, "words": words, "mode": mode}


def scene(name: str) -> dict[str, Any]:
    """The constants that a picture of a task needs."""
    if name == "push-t":
        return {
            "scale": SCALE[name],
            "turn": TURN,
            "size": push_t.SIZE,
            "goal": list(push_t.GOAL),
            "outline": [list(corner) for corner in push_t.OUTLINE],
            "radius": push_t.AGENT_RADIUS,
            "seconds": push_t.CONTROL_SECONDS,
        }
    return {
        "scale": SCALE[name],
        "modes": list(arm.MODES["ring"]),
        "pillarColor": PILLAR,
        "goalColor": GOAL_MARK,
        "reach": arm.SUCCESS,
        "seconds": arm.CONTROL_SECONDS,
    }


def compare(
    name: str,
    policies: Mapping[str, ChunkPolicy],
    evaluations: Sequence[int],
    starts: Sequence[int],
    *,
    progress: bool | None = False,
) -> dict[str, Any]:
    """Replays of several policies of a task from the same starts and with the same noise.

    Args:
        name: of the task.
        policies: method or title -> policy.
        evaluations: numbers of evaluations for each chunk.
        starts: seeds.
        progress: show a progress bar; if None, in terminals and notebooks.

    Raises:
        ValueError: a policy is of another task.
    """
    for key, policy in policies.items():
        found = drawable(policy.windows.task)
        if found != name:
            raise ValueError(f"policy {key} must be of the task {name}, got one of {found}")
    runs = {
        key: {
            str(nfe): record(with_nfe(policy, nfe), starts, progress=progress)
            for nfe in evaluations
        }
        for key, policy in policies.items()
    }
    return {"scene": scene(name), "runs": runs}


def with_nfe(policy: ChunkPolicy, nfe: int) -> ChunkPolicy:
    """The same policy with another number of evaluations.

    Raises:
        ValueError: its sampler has a fixed number.
    """
    if policy.sampler.nfe == nfe:
        return policy
    try:
        return policy.with_sampler(replace(policy.sampler, nfe=nfe))  # type: ignore[type-var]
    except TypeError as error:
        kind = type(policy.sampler).__name__
        raise ValueError(f"nfe must be {policy.sampler.nfe} for the sampler {kind}") from error


def shipped() -> dict[str, Any]:
    """The replays of the course's policies, which `benchmarks/play_replays.py` recorded.

    Raises:
        ValueError: the file is damaged.
    """
    path = find_data(FILE)
    try:
        found: dict[str, Any] = json.loads(gzip.decompress(path.read_bytes()))
        return {"tasks": found["tasks"], "forty": found["forty"]}
    except (OSError, EOFError, ValueError, KeyError) as error:
        raise ValueError(f"{path} is damaged, restore it ({error})") from error
