"""Convex potentials and actions."""

from copy import deepcopy
from functools import partial
from unittest import mock

import torch

from array_cases.base import X0, X1, C, D, K, N, add, g
from cotlearn import potentials
from cotlearn.potentials import convex

CONVEX = potentials.ICNN(D, width=8, depth=1, seed=0)
PARTIAL = potentials.PICNN(D, K, width=8, depth=1, condition_width=4, seed=0)
SMOOTH = potentials.LogSumExp(D, seed=0)


FUNCTIONS = {
    "transport": {"x0": X0},
    "invert": {"y": X0, "t": torch.linspace(0.1, 1, N)},
    "dual_objective": {"x0": X0, "x1": X1},
}
for _potential, _given in ((CONVEX, {}), (PARTIAL, {"c": C}), (SMOOTH, {})):
    for _name, _arrays in FUNCTIONS.items():
        _call = partial(getattr(potentials, _name), _potential)
        add(f"potentials.{_name}, {type(_potential).__name__}", _call, **_arrays, **_given)
add("potentials.ICNN.start_at_gaussian", deepcopy(CONVEX).start_at_gaussian, x1=X1)
_start = mock.patch.dict(convex.START, steps=2)(deepcopy(PARTIAL).start_at_gaussian)
add("potentials.PICNN.start_at_gaussian", _start, x1=X1, c=C)
_law, _key = potentials.ConditionalGaussian(D), "potentials.ConditionalGaussian"
_one = torch.rand(N, _law.conditions().shape[1], generator=g())
add(f"{_key}.sample_given", lambda c: _law.sample_given(c, generator=g()), c=_one)
add(f"{_key}.transport", _law.transport, x0=X0, c=_one)
add("potentials.KnownMap.transport", potentials.KnownMap.gaussian(D).transport, x0=X0)
