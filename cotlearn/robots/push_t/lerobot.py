"""LeRobot's Push-T with key points, such as lerobot/pusht_keypoints: the pose from the points."""

import numpy as np

from cotlearn.robots.layout import (
    ENVIRONMENT_STATE,
    EPISODE,
    FRAME,
    STATE,
    Columns,
    LeRobotLayout,
)
from cotlearn.robots.plane import rotate
from cotlearn.robots.push_t.constants import CONTROL_SECONDS, KEYPOINTS, SUCCESS
from cotlearn.robots.push_t.geometry import corners, coverage
from cotlearn.robots.task import Array

RIGID = 2.0  #: largest distance of key points from a rigid T, pixels


def pose_of(points: Array) -> tuple[Array, Array]:
    """Fit poses (n, 3) of the T to key points (n, 8, 2); also return the largest misses (n,).

    This is least squares over rotations and translations (Kabsch in the plane).
    """
    own = np.array(KEYPOINTS)
    middle, own_middle = points.mean(axis=1), own.mean(axis=0)
    there, here = points - middle[:, None], own - own_middle
    along = (there * here).sum(axis=(1, 2))
    across = (here[:, 0] * there[..., 1] - here[:, 1] * there[..., 0]).sum(axis=1)
    angle = np.arctan2(across, along)
    pose = np.column_stack([middle - rotate(own_middle, np.cos(angle), np.sin(angle)), angle])
    miss = np.linalg.norm(corners(pose, points=KEYPOINTS) - points, axis=2).max(axis=1)
    return pose, miss


def _states(columns: Columns) -> Array:
    pose, miss = pose_of(columns[ENVIRONMENT_STATE].reshape(-1, len(KEYPOINTS), 2))
    if not (miss <= RIGID).all():
        row = int(np.flatnonzero(~(miss <= RIGID))[0])
        raise ValueError(
            f"the key points of frame {columns[FRAME][row]} of episode {columns[EPISODE][row]} "
            f"are no T of this size: they miss it by {miss[row]:.3g} pixels"
        )
    return np.hstack([columns[STATE], pose])


def _observations(states: Array) -> Columns:
    points = corners(states[:, 2:], points=KEYPOINTS)
    return {STATE: states[:, :2], ENVIRONMENT_STATE: points.reshape(len(states), -1)}


def _rewards(states: Array) -> Array:
    return np.clip(coverage(states[:, 2:]) / SUCCESS, 0, 1)


LEROBOT = LeRobotLayout(
    instruction="Push the T-shaped block onto the T-shaped target.",
    robot="2d pointer",
    control_seconds=CONTROL_SECONDS,
    widths={STATE: 2, ENVIRONMENT_STATE: 2 * len(KEYPOINTS)},
    content="agent and pose of the T",
    states=_states,
    observations=_observations,
    rewards=_rewards,
)
