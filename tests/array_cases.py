"""A right call of every public function that takes arrays; `test_arrays.py` then spoils it.

A case is a function and its array arguments, all of them right. The functions are those that the
reference lists, outside the stations of the robots that only see what others have checked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import torch

from cotlearn import (
    couplings,
    datasets,
    diagnostics,
    flows,
    gaussian,
    metrics,
    mixtures,
    plots,
    potentials,
)
from cotlearn.flows import diffusion, networks
from cotlearn.robots import arm, episodes, policies, push_t
from cotlearn.robots.registry import find_task

N, D, K = 6, 2, 3


class Case(NamedTuple):
    """A call and its array arguments.

    Attributes:
        call: takes the arrays by name.
        arrays: all right.
        bare: arguments that are not looked at: they stand in the innermost loop, where what calls
            the function has looked already. Of them only this is asked: no other error.
    """

    call: Callable[..., Any]
    arrays: dict[str, Any]
    bare: frozenset[str] = frozenset()


def g(seed: int = 0) -> torch.Generator:
    """A generator."""
    return torch.Generator().manual_seed(seed)


def rows(n: int = N, d: int = D, seed: int = 0) -> torch.Tensor:
    """Normal rows."""
    return torch.randn(n, d, generator=g(seed))


def labels(n: int = N, k: int = K) -> torch.Tensor:
    """One-hot rows, every class among them."""
    return torch.eye(k)[torch.arange(n) % k]


X0, X1, C = rows(), rows(seed=1) + 1, labels()
DATA = datasets.Dataset(rows(40, seed=3), labels(40))
NETWORK = flows.VelocityMLP(D, K, width=8, depth=1, seed=0)
PETALS = mixtures.petals(K)
CONVEX = potentials.ICNN(D, width=8, depth=1, seed=0)
PARTIAL = potentials.PICNN(D, K, width=8, depth=1, condition_width=4, seed=0)
SMOOTH = potentials.LogSumExp(D, pieces=3, seed=0)
LINEAR = gaussian.LinearGaussian.example()
SPD = np.array([[2.0, 0.5], [0.5, 1.0]])
POSE = np.array([[256.0, 256.0, 0.3], [200.0, 300.0, -2.0]])
PAIRS = {"x0": X0, "x1": X1, "c": C}


def pairs(x0: Any, x1: Any, c: Any) -> Any:
    """Pairs of the rows as they stand."""
    index = torch.arange(N)
    return couplings.Pairs(x0, x1, c, index, index)


_aligned = couplings.ModelAligned(warmup_steps=1)
_aligned.observe(NETWORK, 5)
COUPLINGS = {
    "Independent": couplings.Independent(),
    "MinibatchOT": couplings.MinibatchOT(),
    "MinibatchOT, sinkhorn": couplings.MinibatchOT(plan="sinkhorn", sampling="replacement"),
    "ConditionalOT": couplings.ConditionalOT(),
    "ConditionalOT, source": couplings.ConditionalOT(2.0, label="source"),
    "AdaptiveConditionalOT": couplings.AdaptiveConditionalOT(0.9),
    "StratifiedOT": couplings.StratifiedOT(),
    "StratifiedOT, residual": couplings.StratifiedOT(2, residual=True),
    "SemidiscreteOT": couplings.SemidiscreteOT(1.0, iterations=20),
    "ModelAligned": _aligned,
    "Reflow": couplings.Reflow(lambda x0, c: x0 + 1),
}
CASES: dict[str, Case] = {}


def add(name: str, call: Callable[..., Any], bare: tuple[str, ...] = (), **arrays: Any) -> None:
    """Note a case; a name may have several, told apart by a comma."""
    assert name not in CASES
    CASES[name] = Case(call, arrays, frozenset(bare))


# --- couplings --------------------------------------------------------------------------------

for _name, _coupling in COUPLINGS.items():
    add(
        f"couplings.{_name}",
        lambda x0, x1, c, made=_coupling: made(x0, x1, c, generator=g()),
        **PAIRS,
    )
add(
    "couplings.SemidiscreteOT.fit", lambda x1, c: COUPLINGS["SemidiscreteOT"].fit(x1, c), x1=X1, c=C
)
add("couplings.KMeansCondition.fit", couplings.KMeansCondition(2).fit, c=C)
for _name in ("__call__", "labels"):
    _fitted = couplings.KMeansCondition(2).fit(labels(40))
    add(f"couplings.KMeansCondition.{_name}", getattr(_fitted, _name), c=C)
_images = torch.rand(N, 12, generator=g())
add(
    "couplings.PCAKMeansCondition.fit",
    lambda c: couplings.PCAKMeansCondition(components=2, clusters=2).fit(c),
    c=_images,
)
for _name in ("__call__", "labels", "project"):
    _fitted = couplings.PCAKMeansCondition(components=2, clusters=2).fit(_images)
    add(f"couplings.PCAKMeansCondition.{_name}", getattr(_fitted, _name), c=_images)
add("couplings.combine", lambda a, b: couplings.combine({"a": a, "b": b}), a=C, b=X0)
add("couplings.standardise", couplings.standardise, c=X0, reference=X1)

# --- data -------------------------------------------------------------------------------------

add("mixtures.Dataset", datasets.Dataset, x1=X1, c=C)
add("mixtures.Dataset.sample_given", lambda c: DATA.sample_given(c, generator=g()), c=C)
for _name in ("petals", "moving_modes", "rotating_pair", "eight_gaussians", "moons", "fork"):
    _data = getattr(mixtures, _name)()
    _c = _data.sample_conditions(N, generator=g())
    _key = f"mixtures.ConditionalGaussianMixture.{{}}, {_name}"
    add(_key.format("sample_given"), lambda c, d=_data: d.sample_given(c, generator=g()), c=_c)
    add(_key.format("log_density"), _data.log_density, x=X0, c=_c)
    add(_key.format("velocity"), lambda x, c, d=_data: d.velocity(0.5, x, c), x=X0, c=_c)
add(
    "mixtures.ConditionalGaussianMixture.velocity",
    PETALS.velocity,
    t=torch.full((N,), 0.5),
    x=X0,
    c=C,
)

# --- the solvable case ------------------------------------------------------------------------

add(
    "gaussian.LinearGaussian",
    gaussian.LinearGaussian,
    A=LINEAR.A,
    b=LINEAR.b,
    S=LINEAR.S,
    S_c=LINEAR.S_c,
)
_flow = LINEAR.flow(1.0)
add("gaussian.AffineFlow.law_after", _flow.law_after, c=np.array([0.3]))
add(
    "gaussian.AffineFlow.velocity",
    lambda x, c: _flow.velocity(0.5, x, c),
    x=np.ones((N, 2)),
    c=np.ones((N, 1)),
)
add("gaussian.bures_map", gaussian.bures_map, source=SPD, target=np.eye(2))
add("gaussian.bures_squared", gaussian.bures_squared, first=SPD, second=np.eye(2))

# --- diagnostics ------------------------------------------------------------------------------

_x, _c = rows(240, seed=5), labels(240)
add("diagnostics.between_within", diagnostics.between_within, x1=_x, c=_c)
add(
    "diagnostics.prior_skew",
    lambda x0, c: diagnostics.prior_skew(x0, c, relabellings=99),
    x0=_x,
    c=_c,
)
add(
    "diagnostics.frontier",
    lambda x1, c: diagnostics.frontier(
        x1, c, {"i": couplings.Independent()}, batch_size=16, rows=100, repetitions=2
    ),
    x1=_x,
    c=_c,
)
add(
    "diagnostics.recommend",
    lambda x1, c: diagnostics.recommend(x1, c, batch_size=16, rows=100, probe_steps=2),
    x1=_x,
    c=_c,
)
add(
    "diagnostics.error_budget",
    lambda conditions: diagnostics.error_budget(
        NETWORK, PETALS, PETALS.velocity, nfe=1, fine=2, n=8, conditions=conditions
    ),
    conditions=C[:3],
)

# --- flows ------------------------------------------------------------------------------------

add(
    "flows.interpolate",
    flows.interpolate,
    bare=("x0", "x1", "t"),
    x0=X0,
    x1=X1,
    t=torch.linspace(0, 1, N),
)
add("flows.integrate", lambda x0, c: flows.integrate(NETWORK, x0, c, nfe=2), x0=X0, c=C)
add(
    "flows.integrate, dopri5",
    lambda x0, c: flows.integrate(NETWORK, x0, c, method="dopri5"),
    x0=X0,
    c=C,
)
add("flows.sampler", lambda c: flows.sampler(NETWORK, nfe=1)(c, generator=g()), c=C)
_nets = {
    "VelocityMLP": NETWORK,
    "networks.ResidualMLP": networks.ResidualMLP(D, K, width=8, blocks=1, context=4, seed=0),
    "networks.TemporalUNet": networks.TemporalUNet(4, 2, K, widths=(8, 16), context=8, seed=0),
}
for _name, _net in _nets.items():
    add(
        f"flows.{_name}.forward",
        _net,
        bare=("t", "x", "c"),
        t=torch.linspace(0, 1, N),
        x=rows(N, 8) if "UNet" in _name else X0,
        c=C,
    )
_losses = {
    "flows.conditional_flow_matching_loss": flows.conditional_flow_matching_loss,
    "flows.EarlyFlowMatching.__call__": flows.EarlyFlowMatching(0.3),
    "flows.diffusion.regression_loss": diffusion.regression_loss,
    "flows.diffusion.Diffusion.loss": diffusion.Diffusion(4).loss,
}
for _name, _loss in _losses.items():
    add(
        _name,
        lambda x0, x1, c, f=_loss: f(NETWORK, pairs(x0, x1, c), g()),
        bare=("x0", "x1", "c"),
        **PAIRS,
    )
add(
    "flows.diffusion.predict",
    lambda x, c: diffusion.predict(NETWORK, x, c),
    bare=("x", "c"),
    x=X0,
    c=C,
)
add(
    "flows.diffusion.Diffusion.ddim",
    lambda x, c: diffusion.Diffusion(4).ddim(NETWORK, x, c, nfe=2),
    x=X0,
    c=C,
)
add(
    "flows.diffusion.Diffusion.ddpm",
    lambda x, c, noise: diffusion.Diffusion(4).ddpm(NETWORK, x, c, noise=noise),
    x=X0,
    c=C,
    noise=torch.randn(3, N, D, generator=g()),
)

# --- metrics ----------------------------------------------------------------------------------

add("metrics.squared_w2", metrics.squared_w2, a=X0, b=X1)
add("metrics.joint_squared_w2", metrics.joint_squared_w2, a=X0, b=X1, c=C)
add(
    "metrics.conditional_squared_w2",
    lambda conditions: metrics.conditional_squared_w2(
        PETALS.sample_given, PETALS, conditions=conditions, n=8, generator=g()
    ),
    conditions=C[:3],
)
add("metrics.l2_uvp", metrics.l2_uvp, mapped=X0, truth=X1)
add("metrics.energy_distance", metrics.energy_distance, a=X0, b=X1)
add("metrics.straightness", lambda x0, c: metrics.straightness(NETWORK, x0, c, nfe=4), x0=X0, c=C)
add("metrics.bootstrap_interval", metrics.bootstrap_interval, values=np.arange(5.0))
add("metrics.paired_bootstrap", metrics.paired_bootstrap, first=np.eye(3), second=np.ones((3, 3)))
add("metrics.energy_score", metrics.energy_score, samples=torch.stack([X0, X1, X0 + X1]), truth=X1)
add("metrics.mode_entropy", metrics.mode_entropy, modes=np.array([[0, 1, 1, 2], [0, 0, 0, 0]]))

# --- potentials -------------------------------------------------------------------------------

for _name, _potential, _given in (
    ("ICNN", CONVEX, {}),
    ("PICNN", PARTIAL, {"c": C}),
    ("LogSumExp", SMOOTH, {}),
):
    for _method in ("forward", "gradient", "hessian"):
        add(f"potentials.{_name}.{_method}", getattr(_potential, _method), x=X0, **_given)
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

# --- robots -----------------------------------------------------------------------------------

_history = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 2, 1))
_actions = np.full((3, 4, 2), 220.0)
_states = _history[:, 0]
_windows = episodes.Windows(
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
        f"robots.policies.ChunkPolicy.{_name}",
        lambda history, noise, f=_method: f(history, noise=noise),
        history=_history,
        noise=_chunks[None],
    )
add("robots.episodes.Windows.condition", _windows.condition, history=_history)
add("robots.episodes.Windows.check_history", _windows.check_history, history=_history)
add("robots.episodes.Windows.chunks", _windows.chunks, actions=_actions, history=_history)
# NaN goes through here: `ChunkPolicy.chunk` says then that the training went wrong.
add("robots.episodes.Windows.actions", _windows.actions, bare=("x",), x=_chunks, history=_history)
add(
    "robots.episodes.Episodes",
    lambda state, action, ends, intention, seed: episodes.Episodes(
        state, action, ends, intention=intention, seed=seed
    ),
    state=_states,
    action=_actions[:, 0],
    ends=np.array([1, 3]),
    intention=_actions[:, 0],
    seed=np.array([3, 4]),
)
add(
    "robots.episodes.Episodes.select",
    lambda index: episodes.Episodes(_states, _actions[:, 0], np.array([1, 3])).select(index),
    index=np.array([1, 0]),
)
add("robots.push_t.corners", push_t.corners, bare=("pose", "points"), pose=POSE, points=np.eye(2))
add("robots.push_t.coverage", push_t.coverage, bare=("pose",), pose=POSE)
add("robots.push_t.Simulation", push_t.Simulation, state=_states[0])
add("robots.push_t.Simulation.reset", push_t.Simulation(_states[0]).reset, state=_states[0])
add("robots.push_t.Simulations", push_t.Simulations, states=_states)
add(
    "robots.push_t.Simulations.step",
    lambda actions, active: push_t.Simulations(_states).step(actions, active=active),
    actions=_actions[:, 0],
    active=np.array([True, False, True]),
)
_joints = np.array(arm.solve(np.array([[0.5, 0.0, 0.4]])).joints)
add("robots.arm.forward", arm.forward, bare=("joints",), joints=_joints)
add("robots.arm.skeleton", arm.skeleton, bare=("joints",), joints=_joints)
add("robots.arm.solve", arm.solve, targets=np.array([[0.5, 0.0, 0.4]]), start=_joints)
_starts = np.array([arm.random_start(np.random.default_rng(i), "ring") for i in range(3)])
add("robots.arm.pillars", arm.pillars, states=_starts)
_tracks = np.repeat(_starts[:, None], 8, axis=1)
_paths = np.linspace([0.3, -0.2, 0.3], [0.5, 0.2, 0.3], 8)[None].repeat(3, axis=0)
add("robots.arm.way_round", lambda paths: arm.way_round(paths, "ring"), paths=_tracks)

# --- plots ------------------------------------------------------------------------------------
# A figure may show a gap where a number is missing, so of figures it is only asked that they say
# what is wrong where they cannot be drawn.


def _drawn(draw: Callable[..., Any]) -> Callable[..., None]:
    """The function without its figure."""

    def call(**arrays: Any) -> None:
        try:
            draw(**arrays)
        finally:
            plt.close("all")

    return call


_way = np.cumsum(np.random.default_rng(0).normal(size=(5, N, 2)), axis=0)
_square = np.linspace(0, 1, 4)
for _name, _draw, _arrays in (
    ("scatter", plots.scatter, {"x": X0, "c": C, "x0": X1}),
    ("pair_lines", plots.pair_lines, {"x0": X0, "x1": X1, "c": C}),
    ("paired_source", plots.paired_source, {"x0": X0, "c": C}),
    ("source_given_condition", plots.source_given_condition, {"x0": X0, "c": C}),
    ("trajectories", plots.trajectories, {"path": _way, "c": C}),
    ("velocity_field", plots.velocity_field, {"points": X0, "velocity": X1}),
    ("net", plots.net, {"knots": np.random.default_rng(0).normal(size=(4, 4, 2))}),
    ("outlines", plots.outlines, {"curves": _way, "c": C, "truth": _way}),
    (
        "contours",
        plots.contours,
        {"across": _square, "up": _square, "height": np.outer(_square, _square)},
    ),
    ("image_grid", plots.image_grid, {"images": np.random.default_rng(0).uniform(size=(5, 64))}),
    ("push_t_state", plots.push_t_state, {"state": _states[0]}),
    ("push_t_episode", plots.push_t_episode, {"states": _states}),
    ("push_t_chunks", plots.push_t_chunks, {"state": _states[0], "chunks": _actions}),
    (
        "arm_paths",
        lambda paths, state, modes: plots.arm_paths(paths, state, modes=modes, labels=("a", "b")),
        {"paths": _paths, "state": _starts[0], "modes": np.array([0, 1, 0])},
    ),
    (
        "arm_paths_3d",
        lambda paths, state: plots.arm_paths_3d(paths, state),
        {"paths": _paths, "state": _starts[0]},
    ),
    (
        "arm_pose",
        lambda points, state: plots.arm_pose(points, state),
        {"points": arm.skeleton(_joints)[0], "state": _starts[0]},
    ),
    (
        "strata_heatmap",
        lambda values: plots.strata_heatmap(values, rows=[1, 2], columns=[1, 2, 3]),
        {"values": np.ones((2, 3))},
    ),
    (
        "curves",
        lambda x, values: plots.curves(x, {"a": values}, xlabel="x", ylabel="y"),
        {"x": _square, "values": _square},
    ),
    (
        "error_against_nfe",
        lambda nfe, errors: plots.error_against_nfe(nfe, {"independent": errors}),
        {"nfe": np.array([1, 2, 4]), "errors": np.array([0.3, 0.2, 0.1])},
    ),
    (
        "histogram",
        lambda values: plots.histogram({"independent": values}, xlabel="x"),
        {"values": _square},
    ),
):
    add(f"plots.{_name}", _drawn(_draw), bare=tuple(_arrays), **_arrays)
