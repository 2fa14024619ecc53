"""Policies act on histories of states."""

import numpy as np

from array_cases.base import add, rows
from cotlearn.flows import networks
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.samplers import FlowSampler
from cotlearn.policies.windows import Windows
from cotlearn.robots.registry import find_task

_windows = Windows(
    task=find_task("push-t"),
    observe=2,
    predict=4,
    frame="body",
    observation_range=np.array([[-1.0] * 6, [1.0] * 6]),
    action_range=np.array([[-1.0] * 2, [1.0] * 2]),
)
_sizes = {"width": 8, "blocks": 1, "context": 4}
_network = networks.ResidualMLP(_windows.dim, _windows.condition_dim, **_sizes, seed=0)
_policy = ChunkPolicy(_network, _windows, FlowSampler(1), execute=2)
_history = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 2, 1))
_given = {"history": _history, "noise": rows(3, _windows.dim)[None]}
add("policies.policy.ChunkPolicy.act", _policy.act, **_given)
add("policies.policy.ChunkPolicy.chunk", _policy.chunk, **_given)
