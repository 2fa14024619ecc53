"""Which settings are left when no change of a single one helps?

Each policy of own_settings.py, at one and two evaluations, starts at its own number of actions and
temperature. Then one setting after the other takes the value with the most successes on exploration
starts (ties: the task's score), until no change of one has more: executed actions, temperature, and
two of last_plan.py, the time t where plans start (for a regression, the noise on its chunks) and
the weight of older plans. A hundred rollouts can be luck, so the three best settings of all that
were tried, and its own, are compared by 300. What is left, and its own settings ("without"), are
rolled out from the starts that the tables report. Variety is the entropy of ways from one start.

    python benchmarks/settled.py push-t

needs the weights and cells of own_settings.py, and writes data/results/settled_push_t.json. Those
of another length end in its steps: push-t-30000. An interrupted run goes on.
"""

import argparse
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from cells import RESULTS, opened
from last_plan import LastPlan
from own_settings import CHOICES

from cotlearn.metrics import mode_entropy, wilson_interval
from cotlearn.policies.comparison.scores import mode_draws
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, Rollouts, rollout
from cotlearn.results import read_json

SETTINGS = {**CHOICES, "t": (0.0, 0.1, 0.2, 0.3, 0.5), "older": (0.0, 0.5, 1.0)}
#: Values that are tried as well, once no change among the first ones helps.
MORE = {
    "execute": (3, 6, 12),
    "temperature": (0.0, 0.2, 1.5),
    "t": (0.15, 0.25, 0.4, 0.7, 0.85),
    "older": (0.25,),
}
#: What a regression tries in place of t: the first, then these as well.
NOISES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3), (0.025, 0.075, 0.125, 0.4)
#: So many of the best settings, and a policy's own, are compared on so many exploration starts.
FINALISTS, FINAL = 3, 300
Settings = tuple[float, ...]  # values of SETTINGS, in its order
Value = Callable[[Settings], Any]  # what settings are worth


def settle(now: Settings, options: list[Settings], value: Value) -> Settings:
    """Settings that no change of a single one to another of its options makes worth more."""
    changed = True
    while changed:
        changed = False
        for i, values in enumerate(options):
            best = max([now] + [(*now[:i], to, *now[i + 1 :]) for to in values], key=value)
            now, changed = best, changed or best != now
    return now


def best_again(tried: Iterable[Settings], first: Settings, value: Value, again: Value) -> Settings:
    """Of the settings that are worth most, and the first ones, the best on a second look."""
    finalists = sorted(tried, key=value, reverse=True)[:FINALISTS]
    return max([*finalists, first], key=again)


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", help="a task of own_settings.py")
    parser.add_argument("--episodes", type=int, help="as many as own_settings.py if not given")
    asked = parser.parse_known_args()[0]
    stem = asked.task.replace("-", "_")
    own = read_json(RESULTS / f"own_settings_{stem}.json", "protocol")
    cells = Path(__file__).parent / "results" / f"own_settings_{stem}"
    trials, episodes = own["protocol"]["trials"], asked.episodes or own["protocol"]["episodes"]
    final, reported = max(FINAL, trials), range(REPORTED, REPORTED + episodes)

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        cell = f"{key['method']}-{key['seed']}"
        loaded = ChunkPolicy.load(Path("build") / cells.name / f"{cell}.safetensors")
        drawn = next(s for s in loaded.sampler.variants if s.name == key["sampler"])
        task = loaded.windows.task
        begin = read_json(cells / f"{cell}.json")["samplers"][key["sampler"]]
        tried: dict[int, dict[Settings, tuple[float, float]]] = {trials: {}, final: {}}

        def with_settings(values: Settings) -> Any:
            at = dict(zip(SETTINGS, values, strict=True))
            policy = replace(
                loaded, sampler=drawn, execute=int(at["execute"]), temperature=at["temperature"]
            )
            return LastPlan(policy, at["t"], at["older"])

        def run(values: Settings, **starts: Any) -> Rollouts:
            return rollout(with_settings(values), progress=False, **starts)

        def value(values: Settings, episodes: int = trials) -> tuple[float, float]:
            known = tried[episodes]
            if values not in known:
                means = run(values, episodes=episodes).summary()
                known[values] = means[task.strictest], means[task.score]
            return known[values]

        first = now = tuple(begin.get(name, 0.0) for name in SETTINGS)
        options: list[Settings] = [()] * len(SETTINGS)
        for more, noises in zip((SETTINGS, MORE), NOISES, strict=True):
            new = more if drawn.random else {**more, "temperature": (), "t": noises}
            options = [old + new[name] for old, name in zip(options, SETTINGS, strict=True)]
            now = settle(now, options, value)
        now = best_again(tried[trials], first, value, partial(value, episodes=final))
        done, before = run(now, seeds=reported), run(first, seeds=reported)
        won = done[task.strictest]
        return {
            **dict(zip(SETTINGS, now, strict=True)),
            "success": float(won.mean()),
            "success_interval": wilson_interval(int(won.sum()), len(won)),
            "score": float(done[task.score].mean()),
            "without": float(before[task.strictest].mean()),
            "variety": mode_entropy(mode_draws(with_settings(now))),
            "variety_without": mode_entropy(mode_draws(with_settings(first))),
            "exploration": {
                number: {", ".join(f"{v:g}" for v in at): worth for at, (worth, _) in known.items()}
                for number, known in tried.items()
            },
            "jerk": float(done.jerk.mean()),
        }

    protocol = {"settings": SETTINGS, "more": MORE, "noises": NOISES, "trials": trials}
    protocol |= {"finalists": FINALISTS, "final": final}
    table = opened(
        __doc__ or "",
        {**protocol, "episodes": episodes, "first_start": REPORTED},
        parser=parser,
        name=f"settled_{stem}",
    )
    table.fill(
        [
            {"method": row["method"], "seed": seed, "sampler": row["sampler"]}
            for row in own["rows"]
            for seed in row["seeds"]
            if row["nfe"] <= 2
        ],
        compute,
    )


if __name__ == "__main__":
    main()
