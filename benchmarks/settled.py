"""Which settings are left when no change of a single one helps?

Each policy of own_settings.py starts at its own number of actions and temperature and at the t of
warm_start.py. Then one setting after the other takes the value with the most successes on
exploration starts (ties: the task's score), until no change of one has more: executed actions,
temperature, t, and the weight of older plans, of which a mean is executed (temporal ensembling,
2304.13705, where 1 is nearest to their default). What is left is rolled out once from the starts
that the tables report.

    python benchmarks/settled.py push-t

needs what those two wrote, and writes data/results/settled_push_t.json. An interrupted run goes on.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from cells import RESULTS, opened
from own_settings import CHOICES
from warm_start import STARTS, WarmStarted

from cotlearn.metrics import wilson_interval
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, Rollouts, rollout
from cotlearn.results import read_json

SETTINGS = {**CHOICES, "t": STARTS, "older": (0.0, 0.5, 1.0)}


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", help="a task of own_settings.py")
    parser.add_argument("--evaluations", type=int, default=1, help="1 or 2")
    asked = parser.parse_known_args()[0]
    task = asked.task.replace("-", "_")
    own = read_json(RESULTS / f"own_settings_{task}.json", "protocol")
    warm = read_json(RESULTS / f"warm_start_{task}.json", "protocol")
    trials, episodes = own["protocol"]["trials"], own["protocol"]["episodes"]
    nfe_of = {(row["method"], row["sampler"]): row["nfe"] for row in own["rows"]}
    begun = {tuple(cell["key"].values()): cell for cell in warm["cells"]}

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        path = Path("build") / f"own_settings_{task}" / f"{key['method']}-{key['seed']}.safetensors"
        loaded = ChunkPolicy.load(path)
        drawn = next(s for s in loaded.sampler.variants if s.name == key["sampler"])
        begin = begun[tuple(key.values())]
        tried: dict[tuple[float, ...], tuple[float, float]] = {}

        def run(values: tuple[float, ...], **starts: Any) -> Rollouts:
            at = dict(zip(SETTINGS, values, strict=True))
            policy = replace(
                loaded, sampler=drawn, execute=int(at["execute"]), temperature=at["temperature"]
            )
            return rollout(WarmStarted(policy, at["t"], at["older"]), progress=False, **starts)

        def value(values: tuple[float, ...]) -> tuple[float, float]:
            if values not in tried:
                done = run(values, episodes=trials)
                means = (done[name].mean() for name in (done.task.strictest, done.task.score))
                tried[values] = tuple(map(float, means))
            return tried[values]

        now, changed = tuple(begin.get(name, 0.0) for name in SETTINGS), True
        while changed:
            changed = False
            for i, (name, options) in enumerate(SETTINGS.items()):
                if name == "temperature" and not drawn.random:
                    continue
                best = max([now] + [(*now[:i], to, *now[i + 1 :]) for to in options], key=value)
                now, changed = best, changed or best != now
        done = run(now, seeds=range(REPORTED, REPORTED + episodes))
        won = done[done.task.strictest]
        return {
            **dict(zip(SETTINGS, now, strict=True)),
            "success": float(won.mean()),
            "success_interval": wilson_interval(int(won.sum()), len(won)),
            "score": float(done[done.task.score].mean()),
            "before": begin["success"],
            "exploration": {
                ", ".join(f"{v:g}" for v in values): success
                for values, (success, _) in tried.items()
            },
            "jerk": float(done.jerk.mean()),
        }

    protocol = {"settings": SETTINGS, "trials": trials, "episodes": episodes}
    table = opened(
        __doc__ or "",
        {**protocol, "first_start": REPORTED},
        parser=parser,
        name=f"settled_{task}",
    )
    keys = [cell["key"] for cell in warm["cells"]]
    few = [k for k in keys if nfe_of[k["method"], k["sampler"]] <= asked.evaluations]
    table.fill(few, compute)


if __name__ == "__main__":
    main()
