"""Convex potentials and actions."""

from unittest import mock

import torch

from array_cases.base import X0, X1, C, D, K, N, add, g
from cotlearn import potentials
from cotlearn.potentials import convex

CONVEX = potentials.ICNN(D, width=8, depth=1, seed=0)
PARTIAL = potentials.PICNN(D, K, width=8, depth=1, condition_width=4, seed=0)
SMOOTH = potentials.LogSumExp(D, seed=0)


for _name, _potential, _given in (
    ("ICNN", CONVEX, {}),
    ("PICNN", PARTIAL, {"c": C}),
    ("LogSumExp", SMOOTH, {}),
):
    add(
        f"potentials.transport, {_name}",
        lambda x0, p=_potential, **c: potentials.transport(p, x0, **c),
        x0=X0,
        **_given,
    )
    add(
        f"potentials.invert, {_name}",
        lambda y, p=_potential, **more: potentials.invert(p, y, **more),
        y=X0,
        t=torch.linspace(0.1, 1, N),
        **_given,
    )
    add(
        f"potentials.dual_objective, {_name}",
        lambda x0, x1, p=_potential, **c: potentials.dual_objective(p, x0, x1, **c),
        x0=X0,
        x1=X1,
        **_given,
    )
add(
    "potentials.ICNN.start_at_gaussian",
    potentials.ICNN(D, width=8, depth=1, seed=0).start_at_gaussian,
    x1=X1,
)
add(
    "potentials.PICNN.start_at_gaussian",
    mock.patch.dict(convex.START, steps=2)(
        potentials.PICNN(D, K, width=8, depth=1, condition_width=4, seed=0).start_at_gaussian
    ),
    x1=X1,
    c=C,
)
_conditional = potentials.ConditionalGaussian(D)
_one = torch.rand(N, _conditional.conditions().shape[1], generator=g())
add(
    "potentials.ConditionalGaussian.sample_given",
    lambda c: _conditional.sample_given(c, generator=g()),
    c=_one,
)
add("potentials.ConditionalGaussian.transport", _conditional.transport, x0=X0, c=_one)
add("potentials.KnownMap.transport", potentials.KnownMap.gaussian(D).transport, x0=X0)
