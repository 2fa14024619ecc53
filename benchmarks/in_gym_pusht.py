"""Do policies reach the same in gym-pusht itself as in the course's Push-T?

Rolls stored policies out in gym-pusht 0.1.8, one episode after the other, from the starts and with
the noise of `rollout`, beside the course's own simulation.

    python benchmarks/in_gym_pusht.py build/push_t_human/independent-0.safetensors

writes data/results/in_gym_pusht.json. An interrupted run goes on.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from cells import opened

from cotlearn.couplings.base import generator_for
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import NOISE, REPORTED, rollout
from cotlearn.robots.push_t.simulation import random_state

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "robots"))
import push_t_peer  # of the tests: it makes gym-pusht run beside pymunk 7

EPISODES = 200


def name_of(path: Path) -> str:
    """Folder and name of a policy's file: the folder says what it predicts."""
    return f"{path.parent.name}/{path.stem}"


def coverage_there(environment: Any, policy: ChunkPolicy, number: int) -> float:
    """The best coverage of an episode in gym-pusht."""
    state = random_state(np.random.default_rng(REPORTED + number))
    with push_t_peer.without_counter():
        push_t_peer.start(environment, state)
    now = np.array(environment.get_obs())
    history, best = np.repeat(now[None], policy.windows.observe, axis=0), 0.0
    plan = np.empty((0, 2))
    for step in range(policy.windows.task.max_steps):
        place = step % policy.execute
        if place == 0:
            rng = generator_for(0, step // policy.execute, NOISE)
            noise = policy.noise(EPISODES, rng)[:, number : number + 1]
            plan = policy.act(history[None], noise=noise)[0]
        with push_t_peer.without_counter():
            _, _, _, _, info = environment.step(plan[place])
        best = max(best, float(info["coverage"]))
        if info["is_success"]:
            break
        now = np.array(environment.get_obs())
        history = np.concatenate([history[1:], now[None]])
    return best


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("weights", nargs="+", type=Path, help="files of policies")
    parser.add_argument("--evaluations", default="1,2,16", help="numbers with commas between")
    asked = parser.parse_known_args()[0]
    numbers = [int(n) for n in asked.evaluations.split(",")]

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        policy = ChunkPolicy.load(next(p for p in asked.weights if name_of(p) == key["policy"]))
        few = next(
            s
            for s in policy.sampler.variants
            if s.nfe == key["nfe"] and not s.name.startswith("midpoint")
        )
        policy = policy.with_sampler(few)
        peer = push_t_peer.make()
        there = np.array([coverage_there(peer, policy, number) for number in range(EPISODES)])
        here = rollout(policy, seeds=range(REPORTED, REPORTED + EPISODES))["coverage"]
        return {
            "coverage_there": round(float(there.mean()), 4),
            "coverage_here": round(float(here.mean()), 4),
            "success_there": float((there > 0.95).mean()),
            "success_here": float((here > 0.95).mean()),
            "same_within_.001": float((np.abs(there - here) < 1e-3).mean()),
        }

    table = opened(__doc__ or "", {"episodes": EPISODES}, parser=parser)
    keys = [{"policy": name_of(path), "nfe": nfe} for path in asked.weights for nfe in numbers]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
