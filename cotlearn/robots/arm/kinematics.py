"""Forward and inverse kinematics of the arm, for many arms at once.

The lengths and angles are the Denavit-Hartenberg parameters of the Franka Panda in Craig's
convention, as published by its manufacturer. The tool is a rod along the axis of the flange.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.arm.constants import HIGH, LOW, TOOL
from cotlearn.robots.task import Array
from cotlearn.validation import check_array

JOINTS = 7
_A = np.array([0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088])
_ALPHA = np.array([0, -1, 1, 1, -1, 1, 1]) * (math.pi / 2)
_D = np.array([0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0])
FLANGE = 0.107  #: metres from the last joint to the flange, along the joint's axis

LOWER = np.array([-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973])
UPPER = np.array([2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973])
SPEED = np.array([2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61])  #: radians a second at most

#: The preferred posture among all postures with the same tip: over the table, tool down.
REST = np.array([0.0, 0.0, 0.0, -2.2, 0.0, 2.2, math.pi / 4])

TOLERANCE = 1e-4  #: largest distance of the tip from a reached target, metres
TILT = 1e-3  #: largest tilt of the tool from straight down at a reached target, radians
_LEVER = 0.2  #: metres of error that weigh as much as a radian of tilt
_DAMPING = 1e-8  #: smallest squared damping, in square metres
_POSTURE = 0.3  #: share of the way to the preferred posture that an iteration attempts
_FARTHEST = 0.15  #: largest step of the tip that an iteration aims at, metres

# The frame of a joint in the previous joint's frame at angle 0: rotated by alpha about x, shifted.
_OFFSETS = np.stack([_A, -np.sin(_ALPHA) * _D, np.cos(_ALPHA) * _D], axis=1)
_COS_ALPHA, _SIN_ALPHA = np.cos(_ALPHA), np.sin(_ALPHA)


@dataclass(frozen=True)
class Chain:
    """The positions of the parts of n arms, in metres.

    Attributes:
        origins: (n, 7, 3), positions of the joints.
        axes: (n, 7, 3), rotation axes of the joints, unit vectors.
        flange: (n, 3), position of the flange.
        tip: (n, 3), position of the tool's tip.
        down: (n, 3), direction of the tool, a unit vector.
    """

    origins: Array
    axes: Array
    flange: Array
    tip: Array
    down: Array

    @property
    def jacobian(self) -> Array:
        """The Jacobian (n, 3, 7) of the tip's position with respect to the joint angles."""
        return _cross(self.axes, self.tip[:, None] - self.origins)

    @property
    def tilting(self) -> Array:
        """The Jacobian (n, 3, 7) of the tool's direction with respect to the joint angles."""
        return _cross(self.axes, self.down[:, None])


def forward(joints: Array) -> Chain:
    """Forward kinematics of joint angles (n, 7), in radians."""
    return _chain(check_array(joints, "joints", (None, JOINTS)))


def _chain(joints: Array) -> Chain:
    cos, sin = np.cos(joints), np.sin(joints)
    frames = np.zeros((len(joints), JOINTS, 3, 3))  # at first relative to the previous joint
    frames[..., 0, 0], frames[..., 0, 1] = cos, -sin
    frames[..., 1, 0], frames[..., 1, 1] = sin * _COS_ALPHA, cos * _COS_ALPHA
    frames[..., 2, 0], frames[..., 2, 1] = sin * _SIN_ALPHA, cos * _SIN_ALPHA
    frames[..., 1, 2], frames[..., 2, 2] = -_SIN_ALPHA, _COS_ALPHA
    for joint in range(1, JOINTS):
        frames[:, joint] = frames[:, joint - 1] @ frames[:, joint]
    steps = np.empty((len(joints), JOINTS, 3))
    steps[:, 0] = _OFFSETS[0]
    steps[:, 1:] = (frames[:, :-1] @ _OFFSETS[1:, :, None])[..., 0]
    origins = steps.cumsum(axis=1)
    axes = frames[..., 2]
    down = axes[:, -1]
    flange = origins[:, -1] + FLANGE * down
    return Chain(origins, axes, flange, flange + TOOL * down, down)


def skeleton(joints: Array) -> Array:
    """Positions (n, 10, 3) of base, joints, flange and tip for joint angles (n, 7)."""
    chain = forward(joints)
    ends = np.stack([chain.flange, chain.tip], axis=1)
    return np.concatenate([np.zeros((len(ends), 1, 3)), chain.origins, ends], axis=1)


@dataclass(frozen=True)
class Solution:
    """The result of inverse kinematics for n targets.

    Attributes:
        joints: (n, 7), joint angles within their limits; the last iterate if out of reach.
        error: (n,), distance of the tip from the target, metres.
        tilt: (n,), sine of the angle between the tool and straight down; of a tool that points up,
            2 less the sine.
        reached: (n,), whether error and tilt are within `TOLERANCE` and `TILT`.
    """

    joints: Array
    error: Array
    tilt: Array
    reached: NDArray[np.bool_]


def solve(targets: Array, start: Array | None = None) -> Solution:
    """Inverse kinematics: joint angles that bring the tip to targets, with the tool pointing down.

    This is damped least squares. With the error e of tip and tilt and its Jacobian J, each
    iteration takes the step Δq = r + Jᵀ (J Jᵀ + λ² I)⁻¹ (e - J r), where r pulls the redundant
    degrees of freedom towards `REST`, and λ² = |e|² / 10 + 10⁻⁸ (Sugihara 2011, with other
    factors). Rows that have reached their target stop, so that rows are independent. There are at
    most 20 iterations from a given start, otherwise 100.

    Args:
        targets: (n, 3), metres.
        start: (n, 7), initial joint angles; near the solution 1 to 3 iterations suffice. If None,
            start at `REST` rotated towards each target and iterate until the posture is at rest,
            so that the solution depends only on the target.
    """
    targets = check_array(targets, "targets", (None, 3))
    if start is None:
        q = np.tile(REST, (len(targets), 1))
        q[:, 0] += np.arctan2(targets[:, 1], targets[:, 0])
    else:
        q = check_array(start, "start", (len(targets), JOINTS)).copy()
    # of targets farther away than this only the direction counts
    given, targets = targets, np.clip(targets, LOW - 1.0, HIGH + 1.0)
    error, tilt = np.empty(len(q)), np.empty(len(q))
    rows = np.arange(len(q))
    limit = 100 if start is None else 20
    for count in range(limit + 1):
        chain = _chain(q[rows])
        away = targets[rows] - chain.tip
        error[rows] = np.linalg.norm(away, axis=1)
        sine = np.linalg.norm(chain.down[:, :2], axis=1)
        tilt[rows] = np.where(chain.down[:, 2] < 0, sine, 2 - sine)
        if count == limit:
            break
        step = _step(chain, away, q[rows])
        unsettled = (error[rows] > TOLERANCE) | (tilt[rows] > TILT)
        if start is None:
            unsettled |= np.abs(step).max(axis=1) > 1e-6
        rows, step = rows[unsettled], step[unsettled]
        if len(rows) == 0:
            break
        q[rows] = np.clip(q[rows] + step, LOWER, UPPER)
    error = np.linalg.norm(given - targets + (targets - _chain(q).tip), axis=1)
    return Solution(q, error, tilt, (error <= TOLERANCE) & (tilt <= TILT))


def _step(chain: Chain, away: Array, q: Array) -> Array:
    """The step (n, 7) of one iteration of damped least squares."""
    far = np.linalg.norm(away, axis=1, keepdims=True)
    aim = away * np.minimum(1.0, _FARTHEST / np.maximum(far, 1e-12))
    e = np.concatenate([aim, -_LEVER * chain.down[:, :2]], axis=1)
    jacobian = np.concatenate([chain.jacobian, _LEVER * chain.tilting[:, :2]], axis=1)
    damping = 0.1 * (e**2).sum(axis=1) + _DAMPING
    posture = _POSTURE * (REST - q)
    posture[:, [0, 6]] = 0.0  # the arm may turn to any side, and the rod is round
    rest = e - (jacobian @ posture[..., None])[..., 0]
    square = jacobian @ jacobian.swapaxes(1, 2) + damping[:, None, None] * np.eye(5)
    return posture + (jacobian.swapaxes(1, 2) @ np.linalg.solve(square, rest[..., None]))[..., 0]


def _cross(a: Array, b: Array) -> Array:
    """Cross products (n, 3, 7) of vectors (n, 7, 3); np.cross takes three times as long."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=1)
