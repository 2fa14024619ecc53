"""The arm's two tasks, each as a `Task`."""

from __future__ import annotations

import functools

import numpy as np

from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.simulation import ArmWorlds
from cotlearn.robots.arm.task import FAR, HIGH, LOW, MAX_STEPS, WAYS, columns
from cotlearn.robots.task import Task, World


def _task(kind: str) -> Task:
    state = columns(kind)
    return Task(
        name=f"arm-{kind}",
        state=state,
        action=("x", "y", "z"),
        state_limits=np.array([[-FAR] * len(state), [FAR] * len(state)]),
        action_limits=np.stack([LOW, HIGH]),
        max_steps=MAX_STEPS,
        frames={"goal": GoalFrame(kind), "world": World(len(state))},
        worlds=functools.partial(ArmWorlds, kind=kind),
        score="success",
        modes=len(WAYS[kind]),
        mode_steps=MAX_STEPS,
    )


ARM_RING, ARM_AVOID = _task("ring"), _task("avoid")
