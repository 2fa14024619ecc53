"""Demonstrations."""

from functools import partial

import numpy as np

from array_cases.base import add
from cotlearn.robots import episodes
from cotlearn.robots.push_t import PUSH_T

PUSHES = np.full((3, 4, 2), 220.0)
SCENES = np.tile(np.array([200.0, 200.0, 256.0, 256.0, 0.5]), (3, 1))
_given = {"state": SCENES, "action": PUSHES[:, 0], "intention": PUSHES[:, 0]}
_rows = {"ends": np.array([1, 3]), "seed": np.array([3, 4])}
add("robots.episodes.Episodes", partial(episodes.Episodes, task=PUSH_T), **_given, **_rows)
