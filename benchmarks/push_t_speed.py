"""How fast is Push-T beside gym-pusht, and do the two agree over whole episodes?

Usage::

    python benchmarks/push_t_speed.py

It needs gym-pusht 0.1.8 and shapely (see tests/robots/push_t_peer.py); times are those of the CPU.
"""

import importlib.metadata
import math
import sys
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from cells import opened

from cotlearn.robots.push_t import Simulation, coverage, random_state

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests" / "robots"))
import push_t_peer

STEPS = 5_000  #: control steps of one timing
REPEATS = 5  #: timings of which the median counts
EPISODES = {"random": 200, "pushing": 20}  #: of 300 steps, for the agreement
PROTOCOL = {
    "observations": "state",
    "steps": STEPS,
    "repeats": REPEATS,
    "actions": {
        "random": "uniform in the world",
        "pushing": "the T's position plus normal noise of 40 pixels",
    },
    "agreement_episodes": EPISODES,
    "peer": f"gym-pusht {importlib.metadata.version('gym-pusht')} on pymunk "
    f"{importlib.metadata.version('pymunk')}, its contact counter switched off",
}


def main() -> None:
    """Fills the table."""
    table = opened(
        "How many control steps do cotlearn/PushT-v0 and gym-pusht make in a CPU second "
        "on one thread, and how far apart are their states?",
        PROTOCOL,
    )
    keys = [
        {"what": what, "actions": actions}
        for actions in EPISODES
        for what in ("gym-pusht", "cotlearn/PushT-v0", "bare simulation", "agreement")
    ]
    table.fill([*keys, {"what": "coverage of 10,000 poses", "actions": "none"}], cell)


def cell(key: dict[str, Any]) -> dict[str, Any]:
    """One cell of the table."""
    what, actions = key["what"], key["actions"]
    if what == "agreement":
        return agreement(actions)
    if what == "coverage of 10,000 poses":
        poses = np.random.default_rng(0).uniform([200, 200, -3], [312, 312, 3], (10_000, 3))
        return {"microseconds_per_pose": median(lambda: timed(coverage, poses)) * 100}
    seconds = median(lambda: run(what, actions))
    return {"steps_per_cpu_second": round(STEPS / seconds)}


def timed(function: Any, *arguments: Any) -> float:
    """CPU seconds of one call."""
    began = time.thread_time()
    function(*arguments)
    return time.thread_time() - began


def median(measure: Any) -> float:
    """The median of several measurements."""
    return float(np.median([measure() for _ in range(REPEATS)]))


def choose(actions: str, generator: np.random.Generator, state: Any) -> Any:
    """An action, (2,) float32."""
    if actions == "random":
        return generator.uniform(0, 512, 2).astype(np.float32)
    return (np.array(state[2:4]) + generator.normal(0, 40, 2)).clip(0, 512).astype(np.float32)


def run(what: str, actions: str) -> float:
    """CPU seconds of `STEPS` control steps in episodes of at most 300, without choosing actions."""
    generator, seconds = np.random.default_rng(0), 0.0
    with push_t_peer.without_counter():
        env = None if what == "bare simulation" else environment(what)
        steps = 0
        while steps < STEPS:
            world = Simulation(random_state(generator))
            state = world.state if env is None else env.reset(seed=int(world.state[0]))[0]
            for _ in range(min(300, STEPS - steps)):
                action = choose(actions, generator, state)
                began = time.thread_time()
                if env is None:
                    world.step(*action.tolist())
                    state, over = world.state, world.coverage > 0.95
                else:
                    state, _, over, _, _ = env.step(action)
                seconds += time.thread_time() - began
                steps += 1
                if over:
                    break
    return seconds


def environment(what: str) -> Any:
    """An environment as `gymnasium.make` makes it, with the same wrappers for both."""
    if what == "cotlearn/PushT-v0":
        return gymnasium.make(what)
    wrapped = gymnasium.wrappers.OrderEnforcing(
        gymnasium.wrappers.PassiveEnvChecker(push_t_peer.make())
    )
    return gymnasium.wrappers.TimeLimit(wrapped, 300)


def agreement(actions: str) -> dict[str, Any]:
    """The greatest differences over episodes of 300 steps with the same starts and actions."""
    theirs = push_t_peer.make()
    pixels = radians = covered = 0.0
    for seed in range(EPISODES[actions]):
        generator = np.random.default_rng([seed, 1])
        with push_t_peer.without_counter():
            theirs.reset(seed=seed)
        world = Simulation(random_state(np.random.default_rng(seed)))
        for _ in range(300):
            action = choose(actions, generator, world.state)
            state, _, _, _, info = theirs.step(action)
            world.step(*action.tolist())
            pixels = max(pixels, float(np.abs(state[:4] - world.state[:4]).max()))
            turned = math.remainder(state[4] - world.state[4], 2 * math.pi)
            radians = max(radians, abs(turned))
            covered = max(covered, abs(info["coverage"] - world.coverage))
    return {"pixels": pixels, "radians": radians, "coverage": covered}


if __name__ == "__main__":
    main()
