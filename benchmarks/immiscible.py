"""When does an assignment that does not see the condition harm, and when not?

"Immiscible" training (2610.09369) assigns noise to actions in each batch, whatever is observed, and
reports a policy that is no worse and takes the rarer of two ways more often. That is naive OT,
whose noise is skewed. Here people's demonstrations and their mirror images train, in the frame of
the T: a flow; diffusion with the velocity as target; and diffusion with the noise as target, for
three times as long, because it learns slowly. In the frame of the world and with values scaled to
[-1, 1], as in the paper, the last is trained ten times as long, also with the paper's warm-up of 50
epochs. Diffusion is sampled with fresh noise in each of 100 steps (DDPM), as in the paper, and
without (DDIM). Noise is independent, or assigned in blocks of 64, 256 or 2,048 rows, after a
warm-up: the first 400 steps, if nothing else is said. Scores: skew of the pairs,
coverage from exploration starts, and the balance of ways at forks: poses on the mirror's axis,
where left and right are equally good.

    python benchmarks/immiscible.py --data push_t_human.zarr

writes data/results/immiscible.csv. An interrupted run goes on.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import opened
from numpy.typing import NDArray
from torch import Tensor, nn

from cotlearn.couplings import MinibatchOT
from cotlearn.couplings.base import Match, Traits
from cotlearn.diagnostics import linear_skew, prior_skew
from cotlearn.metrics import bootstrap_interval
from cotlearn.policies.methods import METHODS
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import EXPLORATION, rollout
from cotlearn.policies.samplers import DDIMSampler, DDPMSampler, FlowSampler, Sampler
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.randomness import generator_for
from cotlearn.robots.episodes import Episodes, read, split
from cotlearn.robots.push_t.constants import GOAL, SIZE
from cotlearn.robots.push_t.simulation import PushTVectorSim

STEPS, WARM_UP, BATCH = 4000, 400, 256
SIZES = (1, 64, 256, 2048)  #: of an assignment; 1: independent noise
ROLLOUTS, FIRST = 100, EXPLORATION + 200_000
FORKS, DRAWS, LOOK = 24, 32, 40  #: poses, episodes from each, control steps of an episode
PAIRS = 20_480  #: that a skew is measured on
#: name -> row of the table of methods, steps in units of STEPS, options
RECIPES: dict[str, tuple[str, int, dict[str, Any]]] = {
    "flow": ("independent", 1, {"prediction": "velocity"}),
    "diffusion, velocity as target": ("diffusion", 1, {"prediction": "velocity"}),
    "diffusion, noise as target": ("diffusion", 3, {"prediction": "noise"}),
}
#: The frame, the scale and the target of the paper; it trains far longer.
PUBLISHED = "diffusion, as published"
PATIENT = f"{PUBLISHED}, warm-up of 50 epochs"
LONGER: tuple[str, int, dict[str, Any]] = (
    "diffusion",
    10,
    {"prediction": "noise", "frame": "world", "scale": "range"},
)


@dataclass(repr=False, kw_only=True)
class Blind(MinibatchOT):
    """Assigns noise in blocks of `size` rows, once `warm_up` steps are over."""

    size: int = 64
    warm_up: int = WARM_UP
    traits = Traits(uses_ot_batch=True, needs_network=True)
    _step = 0

    def observe(self, network: nn.Module, step: int) -> None:
        """Only the step counts."""
        self._step = step

    def match(self, x0: Tensor, x1: Tensor, c: Tensor | None, rng: np.random.Generator) -> Match:
        """The rows of each block, assigned."""
        rows = np.arange(len(x0))
        if self.size == 1 or self._step < self.warm_up:
            return Match(rows, rows)
        match = super().match
        blocks = (slice(at, at + self.size) for at in range(0, len(rows), self.size))
        found = [rows[b][match(x0[b], x1[b], c, rng).target_index] for b in blocks]
        return Match(rows, np.concatenate(found))


def mirrored(episodes: Episodes) -> Episodes:
    """The episodes and their mirror images about the axis of the goal, the line x + y = SIZE."""
    state, action = episodes.state.copy(), SIZE - episodes.action[:, ::-1]
    state[:, :2], state[:, 2:4] = SIZE - state[:, 1::-1], SIZE - state[:, 3:1:-1]
    state[:, 4] = 2 * GOAL[2] - state[:, 4]
    both = np.concatenate([episodes.state, state]), np.concatenate([episodes.action, action])
    ends = np.concatenate([episodes.ends, episodes.ends[-1] + episodes.ends])
    return Episodes(*both, ends, episodes.task, name=f"{episodes.name}, with mirror images")


def forks() -> NDArray[np.float64]:
    """Starts on the axis: the agent is where the T has to go, and must pass it on one side."""
    rng = np.random.default_rng(0)
    along = np.array([-1.0, 1.0]) / np.sqrt(2)  # the T's own y axis in the goal
    sign = rng.choice([-1.0, 1.0], FORKS)
    place = np.array(GOAL[:2]) + (sign * rng.uniform(50, 110, FORKS))[:, None] * along
    middle = place + 45 * along
    agent = middle - (sign * rng.uniform(115, 140, FORKS))[:, None] * along
    return np.column_stack([agent, place, np.full(FORKS, GOAL[2])])


def ways(policy: ChunkPolicy) -> dict[str, float]:
    """The rarer way's share of episodes, at each fork and of all; a fair coin has .43 and .5."""
    starts, task = forks(), policy.windows.task
    there = replace(task, vector_sim=lambda seeds: PushTVectorSim(starts[np.asarray(seeds)]))
    moved = replace(policy, windows=replace(policy.windows, task=there))
    seeds = np.repeat(np.arange(FORKS), DRAWS).tolist()
    states = rollout(moved, seeds=seeds, max_steps=LOOK, record=True, progress=False).states
    assert states is not None
    aside = (states[..., 0] + states[..., 1] - SIZE) / np.sqrt(2)
    far = np.take_along_axis(aside, np.abs(aside).argmax(axis=0)[None], axis=0)[0]
    left = (far > 0).reshape(FORKS, DRAWS).mean(axis=1)
    each, all_ = np.minimum(left, 1 - left).mean(), min(left.mean(), 1 - left.mean())
    passed = float((np.abs(far) > 40).mean())
    return {"at_each_fork": float(each), "of_all": float(all_), "passed": passed}


def samplers(policy: ChunkPolicy) -> list[Sampler]:
    """Many evaluations with fresh noise in each, many and few without."""
    own = policy.sampler
    if not isinstance(own, DDPMSampler):
        return [FlowSampler(16), FlowSampler(2)]
    few = "leading" if own.prediction == "noise" else "trailing"
    ddim = DDIMSampler(16, own.levels, few, own.clip, own.prediction)
    return [own, ddim]


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="people's demonstrations")
    parser.add_argument("--steps", type=int, default=STEPS, help="fewer to try it out")
    parser.add_argument("--cells", help="numbers with commas between; all without it")
    asked = parser.parse_known_args()[0]
    setting = SETTINGS["push-t-human"]
    training, _ = split(read(asked.data), held_out=setting.held_out)
    training = mirrored(training)
    fifty_epochs = 50 * len(setting.options.windows(training).dataset(training)) // BATCH

    def compute(key: dict[str, Any]) -> list[dict[str, Any]]:
        name, longer, own = {**RECIPES, PUBLISHED: LONGER, PATIENT: LONGER}[key["recipe"]]
        size, steps = max(BATCH, key["size"]), longer * asked.steps
        options = replace(setting.options, steps=steps, ot_batch_size=size, **own)
        warm_up = fifty_epochs if key["recipe"] == PATIENT else WARM_UP
        blind = Blind(size=key["size"], warm_up=warm_up)
        method = replace(METHODS[name], coupling=lambda *_: blind)
        trained = train(method, training, seed=key["seed"], options=options)
        found = []
        for sampler in samplers(trained.policy):
            policy = trained.policy.with_sampler(sampler)
            done = rollout(policy, seeds=range(FIRST, FIRST + ROLLOUTS))
            means = done.summary()
            kept = {n: round(means[n], 4) for n in ("coverage", "success_95", "reward")}
            low, high = bootstrap_interval(done["coverage"])
            kept |= {"coverage_low": low, "coverage_high": high}
            found.append({"sampler": sampler.name, **kept, "ways": ways(policy)})
        data = trained.policy.windows.dataset(training, label=options.label)
        coupling = trained.coupling
        coupling.observe(trained.policy.network, warm_up)
        stream = coupling.stream(
            data,
            batch_size=BATCH,
            ot_batch_size=size,
            generator=generator_for(0, 0, purpose=32),
        )
        pairs = [next(stream) for _ in range(PAIRS // BATCH)]
        x0, c = (torch.cat([getattr(p, name) for p in pairs]) for name in ("x0", "c"))
        near = prior_skew(x0, c, generator=generator_for(0, 0, purpose=33))
        skew = {"explained": linear_skew(x0, c, cells=64).explained, "neighbours": near.statistic}
        shared = {"skew": skew, "training_seconds": round(trained.seconds, 1)}
        return [row | shared for row in found]

    protocol = {"steps": asked.steps, "warm_up": WARM_UP, "rollouts": ROLLOUTS, "forks": FORKS}
    table = opened(__doc__ or "", {**protocol, "draws": DRAWS, "pairs": PAIRS}, parser=parser)
    keys = [
        {"recipe": recipe, "size": size, "seed": seed}
        for seed in (0, 1)
        for recipe in RECIPES
        for size in SIZES
    ]
    keys += [{"recipe": PUBLISHED, "size": size, "seed": 0} for size in (1, 64)]
    keys.append({"recipe": PATIENT, "size": 64, "seed": 0})
    wanted = [int(n) for n in asked.cells.split(",")] if asked.cells else range(len(keys))
    table.fill([keys[n] for n in wanted], compute)


if __name__ == "__main__":
    main()
