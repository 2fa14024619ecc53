"""What should the network of a policy predict, and at which temperature is it drawn from?

Every target of every kind of training, with a third of the steps of `cotlearn bench` and one seed,
judged on held-out demonstrations (energy score) and on exploration starts, which no table reports.
The defaults of `cotlearn.policies.methods` follow from this table.

    python benchmarks/policy_targets.py push-t

writes data/results/policy_targets_push_t.json. An interrupted run goes on.
"""

import argparse
from dataclasses import replace
from typing import Any

from cells import opened

from cotlearn.assets import find_data
from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.comparison.scores import held_out_score
from cotlearn.policies.methods import METHODS
from cotlearn.policies.rollout import rollout
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.robots.episodes import read, split
from cotlearn.robots.registry import find_task

TEMPERATURES = (1.0, 0.8, 0.6, 0.4, 0.2)
CELLS = [
    ("diffusion", "noise"),
    ("diffusion", "data"),
    ("diffusion", "velocity"),
    ("independent", "velocity"),
    ("independent", "data"),
    ("residual", "velocity"),
    ("residual", "data"),
    ("diffusion_residual", "data"),
    ("centred", "velocity"),
    ("centred", "data"),
    ("minibatch_ot", "velocity"),
    ("minibatch_ot", "data"),
]
ROLLOUTS, HELD_OUT = 100, 200


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", choices=SETTINGS)
    parser.add_argument("--cells", help="numbers with commas between; all without it")
    asked = parser.parse_known_args()[0]
    setting = SETTINGS[asked.task]
    options = replace(setting.options, steps=setting.options.steps // 3)
    episodes = read(find_data(find_task(setting.task).demonstrations))
    training, held = split(episodes, held_out=HELD_OUT)

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        method = METHODS[key["method"]]
        chosen = with_choice(method, training, replace(options, prediction=key["target"]))
        trained = train(method, training, options=chosen)
        data = trained.policy.windows.dataset(held, label=options.label)
        return {
            sampler.name: {
                "energy_score": held_out_score(trained.policy.with_sampler(sampler), data),
                "temperatures": {
                    f"{t:g}": rollout(
                        replace(trained.policy, sampler=sampler, temperature=t), episodes=ROLLOUTS
                    ).summary()
                    for t in (TEMPERATURES if sampler.nfe < 100 else (1.0,))
                },
            }
            for sampler in trained.policy.sampler.variants
        }

    table = opened(
        __doc__ or "",
        {"task": asked.task, "steps": options.steps, "rollouts": ROLLOUTS, "held_out": HELD_OUT},
        parser=parser,
        name=f"policy_targets_{asked.task.replace('-', '_')}",
    )
    keys = [{"method": method, "target": target} for method, target in CELLS]
    wanted = [int(n) for n in asked.cells.split(",")] if asked.cells else range(len(keys))
    table.fill([keys[n] for n in wanted], compute)


if __name__ == "__main__":
    main()
