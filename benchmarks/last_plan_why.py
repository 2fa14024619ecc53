"""Does a last plan help by saying which chunk is meant?

At one evaluation on Push-T a flow and DDIM, on independent pairs, start at the t that settled.py
chose, with its other settings too, from a mixture of noise and a guess: what is left of the last
plan; the last plan of another episode; what a regression predicts, the mean of the good chunks; the
mean of all chunks. For comparison they start from noise alone.

    python benchmarks/last_plan_why.py

needs the weights of own_settings.py and the table of settled.py, and writes
data/results/last_plan_why.json. An interrupted run goes on.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import RESULTS, opened
from last_plan import LastPlan
from torch import Tensor

from cotlearn.metrics import wilson_interval
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.results import read_json

GUESSES = ("noise alone", "last plan", "another episode's", "regression", "mean of all")
EPISODES = 200


def weights(method: str, seed: int) -> ChunkPolicy:
    """A trained policy of own_settings.py."""
    return ChunkPolicy.load(Path("build/own_settings_push_t") / f"{method}-{seed}.safetensors")


class Guessing(LastPlan):
    """A policy that starts its plans from another guess."""

    def __init__(self, policy: ChunkPolicy, t: float, kind: str, regression: ChunkPolicy) -> None:
        super().__init__(policy, 0.0 if kind == GUESSES[0] else t)
        self.kind, self.regression = kind, regression

    def guess(self, episode: Any, history: Any) -> Tensor:
        """Chunks (B, d) for episodes (B,)."""
        if self.kind == "regression":
            noise = self.regression.noise(len(episode))
            return self.regression.draw(noise, self.windows.condition(history))
        left = super().guess(episode, history)
        if self.kind == "another episode's":
            return left[torch.from_numpy(np.roll(np.arange(len(episode)), 1))]
        return torch.zeros_like(left) if self.kind == "mean of all" else left


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One guess of one network."""
    policy = weights(key["method"], key["seed"])
    first = next(s for s in policy.sampler.variants if s.nfe == 1)
    settled = read_json(RESULTS / "settled_push_t.json", "cells")["cells"]
    wanted = {"method": key["method"], "seed": key["seed"], "sampler": first.name}
    at = next(cell for cell in settled if cell["key"] == wanted)
    policy = replace(
        policy, sampler=first, execute=int(at["execute"]), temperature=at["temperature"]
    )
    guessing = Guessing(policy, at["t"], key["guess"], weights("behaviour_cloning", key["seed"]))
    done = rollout(guessing, seeds=range(REPORTED, REPORTED + EPISODES), progress=False)
    won = done[done.task.strictest]
    return {
        "success": float(won.mean()),
        "success_interval": wilson_interval(int(won.sum()), EPISODES),
        "score": float(done[done.task.score].mean()),
    }


def main() -> None:
    """Fills the table."""
    opened(__doc__ or "", {"episodes": EPISODES, "first_start": REPORTED}).fill(
        [
            {"method": method, "seed": seed, "guess": guess}
            for method in ("independent", "diffusion")
            for seed in (0, 1)
            for guess in GUESSES
        ],
        compute,
    )


if __name__ == "__main__":
    main()
