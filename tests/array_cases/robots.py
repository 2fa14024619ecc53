"""Demonstrations."""

import numpy as np

from array_cases.base import add
from cotlearn.robots import episodes

PUSHES = np.full((3, 4, 2), 220.0)
SCENES = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 1))
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
