"""How good is each policy with the actions and the temperature that suit it best?

`cotlearn bench` executes eight of sixteen planned actions, and says what a temperature brings. Here
every policy that plans again chooses both for itself, for each number of evaluations: first how
many actions it executes, then the temperature, each by successes (ties: the task's score) on 100
exploration starts. It is rolled out with its choice once, from the starts that the tables report.
The networks predict the chunk, as those of `cotlearn bench TASK --prediction data`; what is not in
the folder of weights is trained.

    python benchmarks/own_settings.py push-t

writes data/results/own_settings_push_t.json. An interrupted run goes on.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from cells import opened

from cotlearn.cli import policies
from cotlearn.metrics import wilson_interval
from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.policies.training import train
from cotlearn.robots.episodes import split

METHODS = "independent,residual,diffusion,diffusion_residual,behaviour_cloning"
EVALUATIONS, TRIALS = (1, 2, 16), 100
#: What is chosen, in this order; in a tie of successes and scores the first value wins.
CHOICES: dict[str, tuple[float, ...]] = {
    "execute": (8, 4, 2, 1),
    "temperature": (1.0, 0.2, 0.4, 0.6, 0.8),
}


def best_of(policy: ChunkPolicy, name: str) -> tuple[ChunkPolicy, dict[str, list[float]]]:
    """The policy with the best value of a choice, and success and score with each value."""
    task, found = policy.windows.task, {}
    for value in CHOICES[name]:
        tried = replace(policy, **{name: value})
        means = rollout(tried, episodes=TRIALS, progress=False).summary()
        found[value] = [means[task.strictest], round(means[task.score], 4)]
    best = replace(policy, **{name: max(found, key=lambda value: found[value])})
    return best, {f"{value:g}": both for value, both in found.items()}


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", help="a setting of cotlearn bench in receding horizon")
    parser.add_argument("--methods", default=METHODS, help="names with commas between")
    parser.add_argument("--seeds", default="0,1,2", help="numbers with commas between")
    parser.add_argument("--data", type=Path, help="demonstrations that do not come along")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--weights", type=Path, help="default: build/own_settings_<task>")
    asked = parser.parse_known_args()[0]
    name = f"own_settings_{asked.task.replace('-', '_')}"
    weights = asked.weights or Path("build") / name
    setting, episodes = policies.setting(asked.task, {"prediction": "data"}, asked.data)
    training, _ = split(episodes, held_out=setting.held_out)
    starts = range(REPORTED, REPORTED + asked.episodes)

    def trained(method: str, seed: int) -> ChunkPolicy:
        path = weights / f"{method}-{seed}.safetensors"
        if not path.is_file():
            options = with_choice(method, training, setting.options)
            found = train(method, training, seed=seed, options=options)
            found.policy.about = {"setting": asked.task, "method": method, "seed": seed}
            found.policy.save(path)
        return ChunkPolicy.load(path)

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        policy, tried = trained(key["method"], key["seed"]), {}
        policy = policy.with_sampler(sampler_of(policy, key["nfe"]))
        for choice in CHOICES:
            policy, tried[choice] = best_of(policy, choice)
        done = rollout(policy, seeds=starts, progress=False)
        won = done[done.task.strictest].astype(int)
        return {
            "sampler": policy.sampler.name,
            **{choice: getattr(policy, choice) for choice in CHOICES},
            "success": float(won.mean()),
            "success_interval": wilson_interval(int(won.sum()), len(won)),
            "score": float(done[done.task.score].mean()),
            "won": won.tolist(),
            "tried": tried,
        }

    protocol = {"prediction": "data", "choices": CHOICES, "trials": TRIALS}
    protocol |= {"episodes": asked.episodes, "first_start": REPORTED}
    table = opened(__doc__ or "", protocol, parser=parser, name=name)
    table.fill(
        [
            {"method": method, "seed": seed, "nfe": nfe}
            for seed in policies.numbers(asked.seeds, "seeds")
            for method in asked.methods.split(",")
            for nfe in ((1,) if method == "behaviour_cloning" else EVALUATIONS)
        ],
        compute,
    )


def sampler_of(policy: ChunkPolicy, nfe: int) -> Any:
    """The sampler of a policy with this many evaluations."""
    return next(s for s in policy.sampler.variants if s.nfe == nfe)


if __name__ == "__main__":
    main()
