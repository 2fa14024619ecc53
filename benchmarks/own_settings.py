"""How good is each policy with the actions and the temperature that suit it best?

`cotlearn bench` executes eight of sixteen planned actions. Here every policy that plans again
chooses for itself, for each number of evaluations: first how many actions it executes, then the
temperature, each by successes (ties: the task's score) on exploration starts. With its choice it is
rolled out once from the starts that the tables report. Networks predict the chunk, as with
`cotlearn bench TASK --prediction data`; what is not in the folder of weights is trained.

    python benchmarks/own_settings.py push-t

writes benchmarks/results/own_settings_push_t/ and data/results/own_settings_push_t.json. An
interrupted run goes on, and two can work side by side on other methods or seeds. With --steps,
--rate, --frame or --prediction a training has another number of steps, learning rate, frame or
target; with --midpoint flows are sampled by one midpoint step. The names end in it.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

from cells import COMMAND, RESULTS

from cotlearn.cli import policies
from cotlearn.policies.comparison.cells import Protocol, read_record
from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.comparison.scores import TRIALS, evaluate
from cotlearn.policies.comparison.summary import summarise
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.training import train
from cotlearn.results import Folder, Values, machine
from cotlearn.robots.episodes import split

METHODS = "independent,residual,diffusion,diffusion_residual,behaviour_cloning"
EVALUATIONS = (1, 2, 16)
#: What is chosen, in this order; the first of equal values wins.
CHOICES: dict[str, tuple[float, ...]] = {
    "execute": (8, 4, 2, 1),
    "temperature": (1.0, 0.4, 0.6, 0.8, 1.25),
}


def choose(policy: ChunkPolicy, trials: int) -> tuple[ChunkPolicy, Values]:
    """The policy with its choices, and success and score with each value that was tried."""
    task, tried = policy.windows.task, {}
    for name, values in CHOICES.items():
        found = {}
        for value in values if policy.sampler.random or name == "execute" else values[:1]:
            other = replace(policy, **{name: value})
            means = rollout(other, episodes=trials, progress=False).summary()
            found[value] = means[task.strictest], round(means[task.score], 4)
        policy = replace(policy, **{name: max(found, key=lambda value: found[value])})
        tried[name] = {f"{value:g}": both for value, both in found.items()}
    return policy, {**{name: getattr(policy, name) for name in CHOICES}, "tried": tried}


def main() -> None:
    """Fills the cells of a task, and writes its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", help="a setting of cotlearn bench in receding horizon")
    parser.add_argument("--methods", default=METHODS, help="names with commas between")
    parser.add_argument("--seeds", default="0,1,2", help="numbers with commas between")
    parser.add_argument("--data", type=Path, help="demonstrations that do not come along")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--trials", type=int, default=TRIALS, help="that make a choice")
    parser.add_argument("--steps", type=int, help="of a training, if not those of the task")
    parser.add_argument("--rate", type=float, help="learning rate, if not that of the task")
    parser.add_argument("--frame", help="of observations and plans, if not that of the task")
    parser.add_argument("--prediction", default="data", help="target of flows and diffusion")
    parser.add_argument("--midpoint", action="store_true", help="two evaluations of flows")
    asked = parser.parse_args()
    name, options = f"own_settings_{asked.task.replace('-', '_')}", {"prediction": asked.prediction}
    if asked.steps:
        name, options = f"{name}_{asked.steps}", {**options, "steps": asked.steps}
    if asked.rate:
        name, options = f"{name}_rate_{asked.rate:g}", {**options, "learning_rate": asked.rate}
    if asked.frame:
        name, options = f"{name}_{asked.frame}", {**options, "frame": asked.frame}
    if asked.prediction != "data":
        name = f"{name}_{asked.prediction}"
    weights = Path("build") / name
    if asked.midpoint:
        name = f"{name}_midpoint"
    folder = Path(__file__).parent / "results" / name
    setting, episodes = policies.setting(asked.task, options, asked.data)
    training, held = split(episodes, held_out=setting.held_out)
    sizes = None, setting.held_out, asked.episodes
    protocol = Protocol(setting.options, *sizes, temperatures=CHOICES["temperature"])
    starts = range(protocol.first_start, protocol.first_start + asked.episodes)

    def trained(method: str, seed: int) -> ChunkPolicy:
        path = weights / f"{method}-{seed}.safetensors"
        if not path.is_file():
            options = with_choice(method, training, setting.options)
            checkpoint = weights / f"{method}-{seed}.training.safetensors"
            started = time.process_time()
            found = train(method, training, seed=seed, options=options, checkpoint=checkpoint)
            about = {"seconds": found.seconds, "parameters": found.parameters}
            about["cpu_seconds_of_last_run"] = time.process_time() - started
            found.policy.about = {"training": about}
            found.policy.save(path)
        return ChunkPolicy.load(path)

    def compute(cell: str) -> Values:
        method, _, seed = cell.rpartition("-")
        policy, found = trained(method, int(seed)), {}
        data = policy.windows.dataset(held, label=setting.options.label)
        variants = {sampler.name: sampler for sampler in reversed(policy.sampler.variants)}
        of_nfe = {sampler.nfe: sampler for sampler in variants.values()}
        if asked.midpoint:
            if "midpoint-2" not in variants:
                raise ValueError(f"--midpoint needs a flow, got the method {method}")
            of_nfe = {2: variants["midpoint-2"]}
        for nfe in EVALUATIONS:
            if nfe in of_nfe:
                own, chosen = choose(policy.with_sampler(of_nfe[nfe]), asked.trials)
                found[own.sampler.name] = {**evaluate(own, data, starts=starts), **chosen}
        about = {"training": policy.about["training"], **machine("pymunk", "mujoco")}
        return {"method": method, "seed": int(seed), "samplers": found, **about}

    record = {**protocol.record(episodes), "execute": list(CHOICES["execute"])}
    record["trials"] = asked.trials
    seeds, methods = policies.numbers(asked.seeds, "seeds"), asked.methods.split(",")
    names = [f"{method}-{seed}" for seed in seeds for method in methods]
    Folder(folder, record, read=read_record).fill(names, compute)
    summarise(folder, RESULTS / f"{name}.json", command=COMMAND)


if __name__ == "__main__":
    main()
