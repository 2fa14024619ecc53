"""The checks of notebook 07."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.homework.checks.common import expect_function, number
from cotlearn.homework.registry import NotYet, exercise

Array = NDArray[np.float64]


@exercise("07.perplexity")
def perplexity(answer: Any) -> None:
    """exp of the entropy, where 0 log 0 = 0."""
    expect_function(answer)
    for p in ([0.5, 0.5], [0.7, 0.2, 0.1], [0.25, 0.25, 0.5], [1.0, 0.0, 0.0], [0.5, 0, 0.5, 0]):
        array = np.array(p)
        value = number(answer(array.copy()))
        logs = np.log(np.where(array > 0, array, 1))
        entropy = -float((array * logs).sum())
        right = math.exp(entropy)
        if abs(value - right) < 1e-4:
            continue
        if math.isnan(value):
            raise NotYet(f"for p = {p} it is nan: 0 log 0 counts as 0, so leave the zeros out")
        for wrong, hint in (
            (entropy, "that is the entropy; the perplexity is exp of it"),
            (1 / right, "the entropy has a minus sign: -sum p log p"),
            (math.exp(entropy / math.log(2)), "exp goes with log; 2 ** goes with log2"),
            (float((array > 0).sum()), "that counts the possible sides, rare ones in full"),
            (1 / float((array**2).sum()), "that is 1 / sum p^2, another count of modes"),
            (math.exp(-float(logs.sum())), "each log is weighted by its p"),
        ):
            if abs(value - wrong) < 1e-4:
                raise NotYet(hint)
        raise NotYet(f"for p = {p} expected {right:.4g}, got {value:.4g}")


@exercise("07.to_body")
def to_body(answer: Any) -> None:
    """R(-angle) (point - place)."""
    expect_function(answer)
    points = np.array([[256.0, 256.0], [100.0, 40.0], [300.0, 410.0]])
    for pose in ((200.0, 300.0, 0.0), (256.0, 256.0, math.pi / 2), (120.0, 340.0, 0.7)):
        place, angle = np.array(pose[:2]), pose[2]
        found = _points(answer(points.copy(), np.array(pose)), 3)
        right = _turn(points - place, -angle)
        if np.allclose(found, right, atol=1e-4):
            continue
        for wrong, hint in (
            (points - place, "moved, and not turned: turn by minus the angle"),
            (_turn(points - place, angle), "turned the wrong way: by minus the angle"),
            (_turn(points, -angle) - place, "first subtract the T's place, then turn"),
            (_turn(points, -angle), "subtract the T's place first"),
            (_turn(points, angle) + place, "that leads from the body frame to the world"),
            (_turn(place - points, -angle), "point minus place, not place minus point"),
        ):
            if np.allclose(found, wrong, atol=1e-4):
                raise NotYet(hint)
        raise NotYet(
            f"at pose {tuple(round(v, 2) for v in pose)} the point (256, 256) should become "
            f"{right[0].round(1).tolist()}, got {found[0].round(1).tolist()}"
        )


def _turn(points: Array, angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def _points(value: Any, rows: int) -> Array:
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise NotYet(f"return an array of points, got {type(value).__name__}") from None
    if array.shape != (rows, 2):
        raise NotYet(f"return an array of shape ({rows}, 2), like the points, got {array.shape}")
    return array
