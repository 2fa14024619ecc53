"""Demonstrations of Push-T as pictures, for those who want to train something else on them.

Nothing of this course reads such files: its trainings draw the pictures that they look at.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from cotlearn.files import atomic_path
from cotlearn.robots.episodes.checked import Episodes
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.push_t.rasteriser import rasterise


def write_pictures(path: str | Path, episodes: Episodes, *, size: int = 96) -> None:
    """Writes pictures, places of the agent and actions as a compressed `.npz`, atomically.

    Its arrays: "pixels" (rows, size, size, 3) uint8, "agent_pos" (rows, 2), "action" (rows, 2)
    float32, and "episode_ends" (episodes,), exclusive.

    Args:
        path: the file.
        episodes: of Push-T; their pictures are held in memory, 28 kB each of 96 x 96.
        size: width and height of a picture in pixels.

    Raises:
        ValueError: episodes of another task, or a size below 1.
    """
    if episodes.task is not PUSH_T:
        raise ValueError(f"episodes must be of push-t, got {episodes.task.name}")
    pictures = rasterise(torch.from_numpy(episodes.state), size=size)
    with atomic_path(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            allow_pickle=False,
            pixels=pictures.contiguous().numpy(),
            agent_pos=episodes.state[:, :2].astype(np.float32),
            action=episodes.action.astype(np.float32),
            episode_ends=episodes.ends,
        )
