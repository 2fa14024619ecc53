"""A replay as a GIF, for where no page can be shown."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.files import atomic_path
from cotlearn.plots.motion import film
from cotlearn.robots.arm.drawing import draw_picture
from cotlearn.robots.arm.kinematics import skeleton, solve
from cotlearn.robots.push_t.rasteriser import rasterise

Image = NDArray[np.uint8]

EVERY = {"push-t": 5, "arm-ring": 2}  #: control steps between two frames
WIDE, TALL = 240, 180  #: pixels of an arm's picture; Push-T is square


def write_film(path: str | Path, task: str, replays: dict[str, Any]) -> Path:
    """Write the first start of every policy, side by side.

    Args:
        path: the GIF to make.
        task: "push-t" or "arm-ring".
        replays: as `replay.compare` returns them.
    """
    columns = []
    for runs in replays["runs"].values():
        run = next(iter(runs.values()))
        states = unpacked(run, replays["scene"])[0, : run["steps"][0] + 1]
        chosen = [*range(0, len(states), EVERY[task]), len(states) - 1]
        columns.append(pictures(task, states[chosen]))
    length = max(map(len, columns))
    frames = [
        np.hstack([column[min(at, len(column) - 1)] for column in columns])
        for at in range(length + 6)  # the last ones stand still
    ]
    with atomic_path(path) as temporary:
        temporary.write_bytes(film(frames, fps=8).data)
    return Path(path)


def unpacked(run: dict[str, Any], scene: dict[str, Any]) -> NDArray[np.float64]:
    """The states (E, T, columns) of a packed run."""
    values = np.frombuffer(base64.b64decode(run["states"]), "<i2").astype(np.float64)
    states = values.reshape(run["shape"]) / scene["scale"]
    if "turn" in scene:
        states[..., 4] *= scene["scale"] / scene["turn"]
    return states


def pictures(task: str, states: NDArray[np.float64]) -> list[Image]:
    """Pictures of states (T, columns); the arm's posture is found again from its tip."""
    if task == "push-t":
        return list(rasterise(states, size=WIDE).numpy())
    found, joints = [], None
    for state in states:
        joints = solve(state[None, :3], joints).joints
        found.append(draw_picture(skeleton(joints)[0], state, (WIDE, TALL), "front"))
    return found
