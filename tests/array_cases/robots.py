"""Policies and demonstrations."""

from __future__ import annotations

import numpy as np

from array_cases.base import add, rows
from cotlearn.flows import networks
from cotlearn.policies import policy as policies
from cotlearn.policies.windows import Windows
from cotlearn.robots import episodes
from cotlearn.robots.registry import find_task

_history = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 2, 1))
PUSHES = np.full((3, 4, 2), 220.0)
SCENES = _history[:, 0]
_windows = Windows(
    task=find_task("push-t"),
    observe=2,
    predict=4,
    frame="body",
    observation_range=np.array([[-1.0] * 6, [1.0] * 6]),
    action_range=np.array([[-1.0] * 2, [1.0] * 2]),
)
_policy = policies.ChunkPolicy(
    networks.ResidualMLP(
        _windows.dim, _windows.condition_dim, width=8, blocks=1, context=4, seed=0
    ),
    _windows,
    policies.FlowSampler(1),
    execute=2,
)
_chunks = rows(3, _windows.dim)
for _name in ("act", "chunk"):
    _method = getattr(_policy, _name)
    add(
        f"policies.policy.ChunkPolicy.{_name}",
        lambda history, noise, f=_method: f(history, noise=noise),
        history=_history,
        noise=_chunks[None],
    )
_condition = _windows.condition(_history)
add("policies.policy.ChunkPolicy.draw", _policy.draw, noise=_chunks[None], c=_condition)
add(
    "policies.windows.Windows",
    lambda observation_range, action_range: Windows(
        find_task("push-t"), 2, 4, "body", observation_range, action_range
    ),
    observation_range=_windows.observation_range,
    action_range=_windows.action_range,
)
add("policies.windows.Windows.condition", _windows.condition, history=_history)
add("policies.windows.Windows.check_history", _windows.check_history, history=_history)
add("policies.windows.Windows.chunks", _windows.chunks, actions=PUSHES, history=_history)
# NaN goes through here: `ChunkPolicy.chunk` says then that the training went wrong.
add("policies.windows.Windows.actions", _windows.actions, bare=("x",), x=_chunks, history=_history)
add(
    "robots.episodes.Episodes",
    lambda state, action, ends, intention, seed: episodes.Episodes(
        state, action, ends, intention=intention, seed=seed
    ),
    state=SCENES,
    action=PUSHES[:, 0],
    ends=np.array([1, 3]),
    intention=PUSHES[:, 0],
    seed=np.array([3, 4]),
)
