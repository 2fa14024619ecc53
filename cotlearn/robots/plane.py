"""Rotations in the plane."""

import numpy as np

from cotlearn.robots.task import Array


def rotate(points: Array, cos: Array | float, sin: Array | float) -> Array:
    """Rotate points (..., 2) counterclockwise by angles given as cosines and sines (...)."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
