"""The checks of notebook 07."""

import math

import numpy as np

from .common import Case, Cases, table, turned


@table("07.perplexity")
def perplexity() -> Cases:
    """The perplexity, exp(entropy), with 0 log 0 = 0."""
    for row in ([0.7, 0.2, 0.1], [0.5, 0.5], [0.25, 0.25, 0.5], [1.0, 0.0, 0.0], [0.5, 0, 0.5, 0]):
        p = np.array(row)
        logs = np.log(np.where(p > 0, p, 1))
        entropy = -(p * logs).sum()
        right = math.exp(entropy)
        wrong = {
            f"for p = {row} it is nan: 0 log 0 counts as 0, so leave the zeros out": math.isnan,
            "that is the entropy; the perplexity is exp of it": entropy,
            "the entropy has a minus sign: -sum p log p": 1 / right,
            "exp goes with log; 2 ** goes with log2": math.exp(entropy / math.log(2)),
            "2 ** goes with log2; exp goes with log": 2**entropy,
            "the entropy is the sum of p log p, not its mean": math.exp(entropy / len(p)),
            "the entropy is not divided by log k": math.exp(entropy / math.log(len(p))),
            "that counts the possible sides, rare ones in full": (p > 0).sum(),
            "that is 1 / sum p^2, another count of modes": 1 / (p**2).sum(),
            "each log is weighted by its p": math.exp(-logs.sum()),
        }
        yield Case((p,), right, wrong)


@table("07.to_body")
def to_body() -> Cases:
    """A point in the frame of the T: R(-angle) (point - place)."""
    points = np.array([[256.0, 256.0], [100.0, 40.0], [300.0, 410.0]])
    for pose in ((200.0, 300.0, 0.0), (256.0, 256.0, math.pi / 2), (120.0, 340.0, 0.7)):
        place, angle = np.array(pose[:2]), pose[2]
        wrong = {
            "moved, and not turned: turn by minus the angle": points - place,
            "turned the wrong way: by minus the angle": turned(points - place, angle),
            "first subtract the T's place, then turn": turned(points, -angle) - place,
            "subtract the T's place first": turned(points, -angle),
            "that leads from the body frame to the world": turned(points, angle) + place,
            "point minus place, not place minus point": turned(place - points, -angle),
        }
        right = turned(points - place, -angle)
        yield Case((points, np.array(pose)), right, wrong, what="the array of points")
