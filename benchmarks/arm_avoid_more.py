"""Do more demonstrations, or a longer training, open the gaps between two rows of pillars?

Independent pairs, naive OT and strata on residuals, trained with as many demonstrations as in
`cotlearn bench arm-avoid` (another 3,800, drawn from all) and with four times as many, for as many
steps and for three times as many. One training seed, starts that no other table reports, options
otherwise those of the benchmark; the number of strata is the frontier's choice for each amount of
data.

    python benchmarks/arm_avoid_more.py

records the demonstrations first (8 minutes; the first 4,000 are the course's), and writes
data/results/arm_avoid_more.json. An interrupted run goes on.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from cells import opened

from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.comparison.scores import held_out_score
from cotlearn.policies.rollout import EXPLORATION, rollout
from cotlearn.policies.samplers import FlowSampler
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.robots.episodes import read, split
from cotlearn.robots.experts.record import record

SETTING: dict[str, Any] = {
    "task": "arm-avoid",
    "recorded": 16_000,
    "seed": 0,
    "held_out": 200,
    "rollouts": 200,
    "first_seed": EXPLORATION + 100_000,
}
METHODS = ("independent", "minibatch_ot", "residual")
DEMONSTRATIONS = (3_800, 15_800)
STEPS = (6_000, 18_000)
EVALUATIONS = (1, 2, 16)
RECORDING = Path(__file__).resolve().parents[1] / "build" / "arm_avoid_16000_demos.npz"


def main() -> None:
    """Fills the table."""
    RECORDING.parent.mkdir(exist_ok=True)
    record(RECORDING, SETTING["task"], episodes=SETTING["recorded"], seed=SETTING["seed"])
    episodes = read(RECORDING)
    table = opened("Do more demonstrations, or a longer training, open the gaps?", SETTING)

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        held_out, seed = SETTING["held_out"], SETTING["seed"]
        training, rest = split(episodes, held_out=held_out, train=key["demonstrations"], seed=seed)
        options = replace(SETTINGS[SETTING["task"]].options, steps=key["steps"])
        options = with_choice(key["method"], training, options)
        trained = train(key["method"], training, seed=seed, options=options)
        windows = trained.policy.windows
        held, seen = (windows.dataset(some, label=options.label) for some in (rest, training))
        values: dict[str, Any] = {
            "clusters": options.clusters,
            "training_seconds": round(trained.seconds, 1),
        }
        for nfe in EVALUATIONS:
            policy = trained.policy.with_sampler(FlowSampler(nfe))
            first = SETTING["first_seed"]
            done = rollout(policy, seeds=range(first, first + SETTING["rollouts"]), progress=False)
            values[f"euler-{nfe}"] = {
                "success": float(done["success"].mean()),
                "collision": float(done["collision"].mean()),
                "succeeded": np.asarray(done["success"]).astype(int).tolist(),
                "energy_held_out": held_out_score(policy, held),
                "energy_trained_on": held_out_score(policy, seen),
            }
        return values

    table.fill(
        [
            {"method": method, "demonstrations": demonstrations, "steps": steps}
            for steps in STEPS
            for demonstrations in reversed(DEMONSTRATIONS)
            for method in METHODS
        ],
        compute,
    )


if __name__ == "__main__":
    main()
