"""What all cells of a comparison share, and how they are written down."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from cotlearn.policies.training import Options
from cotlearn.robots.episodes import Episodes
from cotlearn.storage import atomic_path
from cotlearn.validation import check_count


@dataclass(frozen=True)
class Protocol:
    """What all cells of a comparison share.

    Attributes:
        options: of every training.
        train_episodes: to train on; all that are not held out if None.
        held_out: episodes kept for the energy score.
        episodes: paired rollouts of every policy.
    """

    options: Options = field(default_factory=Options)
    train_episodes: int | None = None
    held_out: int = 200
    episodes: int = 200

    def __post_init__(self) -> None:
        check_count(self.held_out, "held_out")
        check_count(self.episodes, "episodes", minimum=2)
        if self.train_episodes is not None:
            check_count(self.train_episodes, "train_episodes")

    def record(self, episodes: Episodes) -> dict[str, Any]:
        """The protocol and what identifies the demonstrations, as JSON gives it back."""
        record = {**asdict(self), "task": episodes.task.name, "data": _describe(episodes)}
        found: dict[str, Any] = json.loads(json.dumps(record))
        return found


def write_json(path: Path, value: Any) -> None:
    """Writes a file atomically, innermost lists of numbers on one line."""
    text = json.dumps(value, indent=1, allow_nan=False)
    text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    with atomic_path(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def machine() -> dict[str, Any]:
    """Versions and hardware."""
    packages = ("torch", "numpy", "scipy", "pymunk", "mujoco")
    return {
        "versions": {
            "python": platform.python_version(),
            **{name: importlib.metadata.version(name) for name in packages},
        },
        "machine": f"one of {os.cpu_count()} CPU cores of a shared server, {platform.machine()}, "
        f"{torch.get_num_threads()} thread",
    }


def _describe(episodes: Episodes) -> dict[str, Any]:
    digest = hashlib.sha256()
    for array in (episodes.state, episodes.action, episodes.ends):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        "name": episodes.name,
        "episodes": len(episodes),
        "rows": len(episodes.state),
        "sha256": digest.hexdigest(),
    }
