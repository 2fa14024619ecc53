"""Policies, worlds and demonstrations."""

from __future__ import annotations

import numpy as np
import torch

from array_cases.base import add, g, rows
from cotlearn import couplings, flows
from cotlearn.flows import networks
from cotlearn.robots import arm, episodes, policies, push_t, visuomotor
from cotlearn.robots.push_t.camera import Camera
from cotlearn.robots.push_t.rasteriser import rasterise
from cotlearn.robots.push_t.rendering import draw
from cotlearn.robots.push_t.worlds import PushTWorlds
from cotlearn.robots.registry import find_task

POSE = np.array([[256.0, 256.0, 0.3], [200.0, 300.0, -2.0]])


_history = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 2, 1))
PUSHES = np.full((3, 4, 2), 220.0)
SCENES = _history[:, 0]
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
        f"policies.policy.ChunkPolicy.{_name}",
        lambda history, noise, f=_method: f(history, noise=noise),
        history=_history,
        noise=_chunks[None],
    )
_condition = _windows.condition(_history)
add("policies.policy.ChunkPolicy.draw", _policy.draw, noise=_chunks[None], c=_condition)
add(
    "robots.episodes.Windows",
    lambda observation_range, action_range: episodes.Windows(
        find_task("push-t"), 2, 4, "body", observation_range, action_range
    ),
    observation_range=_windows.observation_range,
    action_range=_windows.action_range,
)
add("robots.episodes.Windows.condition", _windows.condition, history=_history)
add("robots.episodes.Windows.check_history", _windows.check_history, history=_history)
add("robots.episodes.Windows.chunks", _windows.chunks, actions=PUSHES, history=_history)
# NaN goes through here: `ChunkPolicy.chunk` says then that the training went wrong.
add("robots.episodes.Windows.actions", _windows.actions, bare=("x",), x=_chunks, history=_history)
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
add(
    "robots.episodes.Episodes.select",
    lambda index: episodes.Episodes(SCENES, PUSHES[:, 0], np.array([1, 3])).select(index),
    index=np.array([1, 0]),
)
add("robots.push_t.corners", push_t.corners, bare=("pose", "points"), pose=POSE, points=np.eye(2))
add("robots.push_t.coverage", push_t.coverage, bare=("pose",), pose=POSE)
add("robots.push_t.Simulation", push_t.Simulation, state=SCENES[0])
add("robots.push_t.Simulation.reset", push_t.Simulation(SCENES[0]).reset, state=SCENES[0])
add("robots.push_t.Simulations", push_t.Simulations, states=SCENES)
add(
    "robots.push_t.Simulations.step",
    lambda actions, active: push_t.Simulations(SCENES).step(actions, active=active),
    actions=PUSHES[:, 0],
    active=np.array([True, False, True]),
)
add(
    "robots.push_t.worlds.PushTWorlds.step",
    lambda actions, active: PushTWorlds([1, 2, 3]).step(actions, active=active),
    actions=PUSHES[:, 0],
    active=np.array([True, False, True]),
)
add("robots.push_t.rasteriser.rasterise", lambda states: rasterise(states, size=8), states=SCENES)
add("robots.push_t.rendering.draw", lambda state: draw(state, size=8), state=SCENES[0])

# --- pictures ---

_camera = Camera(8, 2, low=(0.0,) * 4 + (-1.0,) * 2, high=(512.0,) * 4 + (1.0,) * 2)
_views = rows(3, _camera.scene_dim)
for _name in ("__call__", "scenes", "pictures", "hand"):
    _method = getattr(_camera, _name)
    add(f"robots.push_t.camera.Camera.{_name}", _method, bare=("c",), c=_views)
add(
    "robots.push_t.camera.Camera.over",
    lambda observation_range: Camera.over(observation_range, size=8, observe=2),
    observation_range=_windows.observation_range,
)
_seeing = visuomotor.CameraNetwork(_camera, 8, features=2, width=8, blocks=1, seed=0)
_hand, _features = _seeing.hand(_views), _seeing.encode(_views).detach()
for _name in ("encode", "hand"):
    _method = getattr(_seeing, _name)
    add(f"policies.camera.CameraNetwork.{_name}", _method, bare=("c",), c=_views)
add(
    "policies.camera.CameraNetwork.look",
    _seeing.look,
    bare=("pictures", "hand"),
    pictures=_camera.pictures(_views),
    hand=_hand,
)
add(
    "policies.camera.CameraNetwork.pose_error",
    _seeing.pose_error,
    bare=("features", "c"),
    features=_features,
    c=_views,
)
for _name, _network, _c in (
    ("CameraNetwork", _seeing, _views),
    ("TurnedMLP", _seeing.head, _features),
):
    add(
        f"policies.camera.{_name}.forward",
        _network,
        bare=("t", "x", "c"),
        t=torch.linspace(0, 1, 3),
        x=rows(3, 8),
        c=_c,
    )
_from_the_t = visuomotor.SeenFromT(_camera)
for _name in ("into", "out"):
    add(
        f"policies.camera.SeenFromT.{_name}",
        getattr(_from_the_t, _name),
        bare=("x", "c"),
        x=rows(3, 8),
        c=_views,
    )
add(
    "policies.camera.CameraLoss.__call__",
    lambda x0, x1, c: visuomotor.CameraLoss(flows.conditional_flow_matching_loss, shift=1)(
        _seeing, couplings.Pairs(x0, x1, c, torch.arange(3), torch.arange(3)), g()
    ),
    bare=("x0", "x1", "c"),
    x0=rows(3, 8),
    x1=rows(3, 8, seed=1),
    c=_views,
)

# --- the arm ---

JOINTS = np.array(arm.solve(np.array([[0.5, 0.0, 0.4]])).joints)
add("robots.arm.forward", arm.forward, bare=("joints",), joints=JOINTS)
add("robots.arm.skeleton", arm.skeleton, bare=("joints",), joints=JOINTS)
add("robots.arm.solve", arm.solve, targets=np.array([[0.5, 0.0, 0.4]]), start=JOINTS)
STARTS = np.array([arm.random_start(np.random.default_rng(i), "ring") for i in range(3)])
add("robots.arm.pillars", arm.pillars, states=STARTS)
_tracks = np.repeat(STARTS[:, None], 8, axis=1)
PATHS = np.linspace([0.3, -0.2, 0.3], [0.5, 0.2, 0.3], 8)[None].repeat(3, axis=0)
add("robots.arm.way_round", lambda paths: arm.way_round(paths, "ring"), paths=_tracks)
add("robots.arm.ArmWorlds.at", lambda states: len(arm.ArmWorlds.at(states, "ring")), states=STARTS)
for _name, _to in (("step", STARTS[:, :3]), ("step_joints", np.repeat(JOINTS, 3, axis=0))):
    add(
        f"robots.arm.ArmWorlds.{_name}",
        lambda actions, active, name=_name: getattr(arm.ArmWorlds.at(STARTS, "ring"), name)(
            actions, active=active
        ),
        actions=_to,
        active=np.array([True, False, True]),
    )
