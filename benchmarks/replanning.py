"""How many actions of a chunk should be executed before the next one is drawn?

`cotlearn bench` executes eight of sixteen, as Diffusion Policy does. Here trained policies execute
more or fewer, from the starts that the tables report. Four actions need twice the chunks of eight,
so one evaluation with four costs as much as two with eight. A policy's file is one that
own_settings.py has trained, or one that comes with the course.

    python benchmarks/replanning.py build/own_settings_push_t/independent-0.safetensors \
        --output data/results/replanning_push_t.json

fills one table; the others are listed in data/README.md. An interrupted run goes on.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from cells import opened

from cotlearn.metrics import bootstrap_interval, wilson_interval
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, rollout

EXECUTE, EVALUATIONS = (12, 8, 4, 2), (1, 2, 16)


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("policies", type=Path, nargs="+", help="files of policies")
    parser.add_argument("--episodes", type=int, default=100)
    asked = parser.parse_known_args()[0]
    files = {f"{path.parent.name}/{path.stem}": path for path in asked.policies}

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        policy = ChunkPolicy.load(files[key["policy"]])
        wanted = next(s for s in policy.sampler.variants if s.nfe == key["nfe"])
        policy = policy.with_sampler(wanted)
        policy.execute = key["execute"]
        done = rollout(policy, seeds=range(REPORTED, REPORTED + asked.episodes), progress=False)
        won, score = done[done.task.strictest], done[done.task.score]
        return {
            "sampler": wanted.name,
            "success": float(won.mean()),
            "success_interval": wilson_interval(int(won.sum()), len(won)),
            done.task.score: float(np.mean(score)),
            f"{done.task.score}_interval": bootstrap_interval(score),
            "steps": float(done.steps.mean()),
            "jerk": float(np.nanmean(done.jerk)),
            "chunks": done.chunks,
        }

    protocol = {"episodes": asked.episodes, "first_start": REPORTED}
    table = opened(__doc__ or "", protocol, parser=parser)
    table.fill(
        [
            {"policy": name, "nfe": nfe, "execute": execute}
            for name in files
            for execute in EXECUTE
            for nfe in EVALUATIONS
        ],
        compute,
    )


if __name__ == "__main__":
    main()
