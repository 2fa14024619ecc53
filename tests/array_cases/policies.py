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
_network = networks.ResidualMLP(
    _windows.dim, _windows.condition_dim, width=8, blocks=1, context=4, seed=0
)
_policy = ChunkPolicy(_network, _windows, FlowSampler(1), execute=2)
for _name in ("act", "chunk"):
    _method = getattr(_policy, _name)
    add(
        f"policies.policy.ChunkPolicy.{_name}",
        lambda history, noise, f=_method: f(history, noise=noise),
        history=np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 2, 1)),
        noise=rows(3, _windows.dim)[None],
    )
