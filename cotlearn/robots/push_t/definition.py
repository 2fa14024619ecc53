"""Push-T as a `Task`."""

import numpy as np

from cotlearn.robots.push_t.constants import MAX_STEPS, PIXEL, SIZE, SUCCESS, TURN
from cotlearn.robots.push_t.expert import PushTExpert
from cotlearn.robots.push_t.frames import AgentFrame, BodyFrame, WorldFrame
from cotlearn.robots.push_t.lerobot import LEROBOT
from cotlearn.robots.push_t.simulation import PushTVectorSim
from cotlearn.robots.task import Task

_TURNS = 1e4  #: largest angle in a state, which may exceed one turn

#: The agent can swing a little beyond the world; the T cannot leave it by more than its size.
PUSH_T = Task(
    title="Push-T",
    environment="cotlearn/PushT-v0",
    entry_point="cotlearn.robots.push_t.environment:PushT",
    vector_sim=PushTVectorSim.from_seeds,
    state=("agent x", "agent y", "T x", "T y", "T angle"),
    action=("x", "y"),
    state_limits=np.array([[-SIZE] * 4 + [-_TURNS], [2 * SIZE] * 4 + [_TURNS]]),
    action_limits=np.array([[0.0, 0.0], [SIZE, SIZE]]),
    max_steps=MAX_STEPS,
    frames={"body": BodyFrame(), "world": WorldFrame(), "agent": AgentFrame()},
    score="coverage",
    early_steps=200,  # the time limit of some papers
    capped={"reward": ("coverage", SUCCESS), "reward_200": ("coverage_200", SUCCESS)},
    thresholds={
        "success_90": ("coverage", 0.90),
        "success_95_200": ("coverage_200", SUCCESS),
        "success_95": ("coverage", SUCCESS),
    },
    modes=8,
    mode_steps=80,
    demonstrations="push_t_demos.npz",
    expert=PushTExpert,
    state_units=(PIXEL,) * 4 + (TURN,),
    action_units=(PIXEL,) * 2,
    packages=("numpy", "pymunk"),
    lerobot=LEROBOT,
)
