"""What do the choices made before any coupling give on Push-T?

Flows with one choice other than those of `cotlearn bench push-t` with velocities (the frame, the
labels, the scale, the times, the network), each with independent and with stratified pairs: what
does a coupling add to the choice? One training seed, a third of the steps, and starts that no other
table reports.

    python benchmarks/push_t_choices.py

writes data/results/push_t_choices.json. An interrupted run goes on.
"""

from dataclasses import replace
from typing import Any

from cells import opened
from short_training import train_and_roll

from cotlearn.assets import find_data
from cotlearn.policies.rollout import EXPLORATION
from cotlearn.policies.training import Options
from cotlearn.robots.episodes import read, split

SETTING = {
    "steps": 5000,
    "batch_size": 256,
    "seed": 0,
    "held_out": 200,
    "rollouts": 100,
    "first_seed": EXPLORATION + 100_000,
}
CHOICES: dict[str, dict[str, Any]] = {
    "as in the benchmark": {},
    "frame of the world": {"frame": "world"},
    "labels: noisy actions": {"label": "action"},
    "3 in 10 times at t = 0": {"share_at_t0": 0.3},
    "scale: range": {"scale": "range"},
    "temporal U-Net": {"network": "unet"},
}


def main() -> None:
    """Fills the table."""
    episodes = read(find_data("push_t_demos.npz"))
    training, _ = split(episodes, held_out=SETTING["held_out"])
    table = opened(
        "What do the choices made before any coupling give on Push-T?",
        {**SETTING, "choices": CHOICES},
    )
    common = Options(frame="body", steps=SETTING["steps"], batch_size=SETTING["batch_size"])

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        return train_and_roll(
            key["method"],
            training,
            replace(common, **CHOICES[key["choice"]]),
            **{name: SETTING[name] for name in ("seed", "rollouts", "first_seed")},
        )

    methods = ("independent", "stratified")
    table.fill([{"choice": name, "method": each} for name in CHOICES for each in methods], compute)


if __name__ == "__main__":
    main()
