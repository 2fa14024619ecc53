"""Which weights and which share of jumps suit mean velocities in policies?

MeanFlow with the weights of the paper and with squared errors, with many, few and no rows of length
0, with its times and with uniform ones, and shortcut models with two shares of jumps; on
independent pairs and on those of "residual". Beside them flow matching, as it is and with the
weights of MeanFlow: what the weights do without jumps. Each is trained with a third of the steps of
`cotlearn bench` and one seed, and judged on held-out demonstrations (energy score); exploration
starts are run beside it, and choose nothing. The defaults of `cotlearn.policies.methods` follow
from this table.

    python benchmarks/jump_choices.py arm-ring

writes data/results/jump_choices_arm_ring.json. An interrupted run goes on.
"""

import argparse
from dataclasses import replace
from typing import Any

from cells import opened

from cotlearn.assets import find_data
from cotlearn.flows.matching import FlowMatching
from cotlearn.flows.one_step import MeanFlow, Shortcut
from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.comparison.scores import held_out_score
from cotlearn.policies.methods import METHODS
from cotlearn.policies.rollout import rollout
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.robots.episodes import read, split
from cotlearn.robots.registry import find_task

LOSSES: dict[str, Any] = {
    "flow matching": FlowMatching(share_at_t0=0.3),
    "flow matching, MeanFlow's weights": FlowMatching(share_at_t0=0.3, power=1.0),
    "MeanFlow": MeanFlow(),
    "MeanFlow, 1 in 4 instants": MeanFlow(share_instant=0.25),
    "MeanFlow, no instants": MeanFlow(share_instant=0.0),
    "MeanFlow, squared errors": MeanFlow(power=0.0),
    "MeanFlow, squared errors, no instants": MeanFlow(share_instant=0.0, power=0.0),
    "MeanFlow, uniform times": MeanFlow(uniform=True),
    "MeanFlow, uniform times, 1 in 4 instants": MeanFlow(share_instant=0.25, uniform=True),
    "shortcut, 1 in 8": Shortcut(share=0.125),
    "shortcut, 1 in 4": Shortcut(share=0.25),
}
COST = {"shortcut, 1 in 8": 1 + 0.125 * 2 / 3}  #: where it is not that of the method
SAMPLERS, ROLLOUTS = ("jump-1", "jump-2", "euler-1", "euler-2", "euler-16"), 100


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", choices=SETTINGS)
    parser.add_argument("--cells", help="numbers with commas between; all without it")
    asked = parser.parse_known_args()[0]
    setting = SETTINGS[asked.task]
    options = replace(setting.options, steps=setting.options.steps // 3)
    episodes = read(find_data(find_task(setting.task).demonstrations))
    training, held = split(episodes, held_out=setting.held_out)

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        loss, pairs = key.values()
        kinds = {"shortcut": "shortcut", "MeanFlow": "mean_flow", "flow": "independent"}
        method = METHODS[next(kinds[kind] for kind in kinds if loss.startswith(kind))]
        paired = METHODS[pairs]
        method = replace(
            method,
            loss=lambda options: LOSSES[loss],
            coupling=paired.coupling,
            open_option=paired.open_option,
            pictures=paired.pictures,
            cost=COST.get(loss, method.cost),
        )
        chosen = with_choice(method, training, options)
        trained = train(method, training, options=chosen)
        data = trained.policy.windows.dataset(held, label=options.label)
        found = {}
        for sampler in trained.policy.sampler.variants:
            if sampler.name in SAMPLERS:
                policy = trained.policy.with_sampler(sampler)
                score = round(held_out_score(policy, data), 4)
                done = rollout(policy, episodes=ROLLOUTS).summary()
                found[sampler.name] = {"energy_score": score, "exploration": done}
        return found

    table = opened(
        __doc__ or "",
        {"task": asked.task, "steps": options.steps, "rollouts": ROLLOUTS},
        parser=parser,
        name=f"jump_choices_{asked.task.replace('-', '_')}",
    )
    keys = [{"loss": loss, "pairs": p} for p in ("independent", "residual") for loss in LOSSES]
    wanted = [int(n) for n in asked.cells.split(",")] if asked.cells else range(len(keys))
    table.fill([keys[n] for n in wanted], compute)


if __name__ == "__main__":
    main()
