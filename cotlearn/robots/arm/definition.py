"""The `Task` of each of the arm's two tasks, ring and avoid."""

import functools

import numpy as np

from cotlearn.robots.arm.constants import FAR, HIGH, LOW, MAX_STEPS, MODES, UNIT, columns
from cotlearn.robots.arm.expert import ArmExpert
from cotlearn.robots.arm.frames import GoalFrame
from cotlearn.robots.arm.simulation import ArmVectorSim
from cotlearn.robots.task import Frame, Task


def _task(kind: str) -> Task:
    state = columns(kind)
    return Task(
        title=f"arm-{kind}",
        environment=f"cotlearn/Arm{kind.title()}-v0",
        entry_point="cotlearn.robots.arm.environment:Arm",
        environment_options={"kind": kind},
        vector_sim=functools.partial(ArmVectorSim.from_seeds, kind=kind),
        state=state,
        action=("x", "y", "z"),
        state_limits=np.array([[-FAR] * len(state), [FAR] * len(state)]),
        action_limits=np.stack([LOW, HIGH]),
        max_steps=MAX_STEPS,
        frames={"goal": GoalFrame(kind), "world": Frame(len(state))},
        score="success",
        modes=len(MODES[kind]),
        mode_steps=MAX_STEPS,
        demonstrations=f"arm_{kind}_demos.npz",
        expert=functools.partial(ArmExpert, kind),
        state_units=(UNIT,) * len(state),
        action_units=(UNIT,) * 3,
        packages=("numpy", "mujoco"),
    )


ARM_RING, ARM_AVOID = _task("ring"), _task("avoid")
