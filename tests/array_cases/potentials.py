"""Convex potentials and actions."""

from __future__ import annotations

import torch

from array_cases.base import PAIRS, X0, X1, C, D, K, N, add, g, pairs
from cotlearn import potentials

CONVEX = potentials.ICNN(D, width=8, depth=1, seed=0)
PARTIAL = potentials.PICNN(D, K, width=8, depth=1, condition_width=4, seed=0)
SMOOTH = potentials.LogSumExp(D, pieces=3, seed=0)


for _name, _potential, _given in (
    ("ICNN", CONVEX, {}),
    ("PICNN", PARTIAL, {"c": C}),
    ("LogSumExp", SMOOTH, {}),
):
    for _method in ("forward", "gradient", "hessian"):
        add(f"potentials.{_name}.{_method}", getattr(_potential, _method), x=X0, **_given)
    add(
        f"potentials.{_name}.check",
        lambda x, c=None, p=_potential: p.check(x, c),
        x=X0,
        **_given,
    )
    add(
        f"potentials.transport, {_name}",
        lambda x0, p=_potential, **c: potentials.transport(p, x0, **c),
        x0=X0,
        **_given,
    )
    add(
        f"potentials.inverse_transport, {_name}",
        lambda x1, p=_potential, **c: potentials.inverse_transport(p, x1, **c),
        x1=X0,
        **_given,
    )
    add(
        f"potentials.invert, {_name}",
        lambda y, p=_potential, **more: potentials.invert(p, y, **more),
        y=X0,
        t=torch.linspace(0.1, 1, N),
        start=X1,
        **_given,
    )
    add(
        f"potentials.dual_objective, {_name}",
        lambda x0, x1, p=_potential, **c: potentials.dual_objective(p, x0, x1, **c),
        x0=X0,
        x1=X1,
        **_given,
    )
    for _loss in ("dual_loss", "optimal_flow_matching_loss"):
        _loss_of = getattr(potentials, _loss)
        add(
            f"potentials.{_loss}, {_name}",
            lambda x0, x1, c=None, p=_potential, f=_loss_of: f(p, pairs(x0, x1, c), g()),
            bare=("x0", "x1", "c"),
            x0=X0,
            x1=X1,
            **_given,
        )
    add(
        f"potentials.optimal_flow_matching_loss_at, {_name}",
        lambda x0, x1, t, c=None, p=_potential: potentials.optimal_flow_matching_loss_at(
            p, pairs(x0, x1, c), t
        ),
        bare=("x0", "x1", "c", "t"),
        x0=X0,
        x1=X1,
        t=torch.linspace(0, 1, N),
        **_given,
    )
add(
    "potentials.ICNN.start_at_gaussian",
    lambda x1, x0: potentials.ICNN(D, width=8, depth=1, seed=0).start_at_gaussian(x1, x0=x0),
    x1=X1,
    x0=X0,
)
add(
    "potentials.PICNN.start_at_gaussian",
    lambda x1, c, x0: potentials.PICNN(
        D, K, width=8, depth=1, condition_width=4, seed=0
    ).start_at_gaussian(x1, c, x0=x0, steps=2),
    x1=X1,
    c=C,
    x0=X0,
)
_free = potentials.ActionMLP(D, K, width=8, depth=1, seed=0)
_optimal = potentials.OptimalAction(SMOOTH)
for _name in ("forward", "derivatives", "velocity"):
    add(
        f"potentials.ActionMLP.{_name}",
        getattr(_free, _name),
        bare=("t", "x", "c"),
        t=torch.linspace(0, 1, N),
        x=X0,
        c=C,
    )
    add(
        f"potentials.OptimalAction.{_name}",
        getattr(_optimal, _name),
        t=torch.linspace(0, 0.9, N),
        x=X0,
    )
add(
    "potentials.OptimalField.__call__",
    potentials.OptimalField(SMOOTH),
    t=torch.linspace(0, 0.9, N),
    x=X0,
)
add(
    "potentials.action_matching_loss",
    lambda x0, x1, c: potentials.action_matching_loss(_free, pairs(x0, x1, c), g()),
    bare=("x0", "x1", "c"),
    **PAIRS,
)
_conditional = potentials.ConditionalGaussian(D)
_one = torch.rand(N, _conditional.conditions().shape[1], generator=g())
add("potentials.ConditionalGaussian.moments", _conditional.moments, c=_one)
add(
    "potentials.ConditionalGaussian.sample_given",
    lambda c: _conditional.sample_given(c, generator=g()),
    c=_one,
)
add("potentials.ConditionalGaussian.transport", _conditional.transport, x0=X0, c=_one)
add("potentials.KnownMap.transport", potentials.KnownMap.gaussian(D).transport, x0=X0)
add("potentials.map_sampler", lambda c: potentials.map_sampler(PARTIAL)(c, generator=g()), c=C)
