"""What does a plan gain that starts from the last one instead of noise?

Where a policy plans again, what is left of the last plan is a guess for the new one. A warm start
mixes it with the noise, as pairs at time t are mixed in training, and samples from t on. Each
policy of own_settings.py keeps its number of actions and its temperature; exploration starts choose
t, or 0, by successes (ties: the task's score). A regression has no noise: there 100 rollouts choose
how much normal noise is added to its chunks, in units of their deviation. What is chosen is rolled
out once from the starts that the tables report.

    python benchmarks/warm_start.py push-t

needs the weights and cells of own_settings.py, and writes data/results/warm_start_push_t.json. An
interrupted run goes on.
"""

import argparse
import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import RESULTS, opened
from torch import Tensor, nn

from cotlearn.flows.matching import velocity_of
from cotlearn.metrics import wilson_interval
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import REPORTED, Rollouts, rollout
from cotlearn.policies.samplers import JumpSampler, MeanSampler, Sampler, diffusion_of
from cotlearn.results import read_json

STARTS = (0.0, 0.1, 0.2, 0.3, 0.5)  #: times t, of a regression its noise


@dataclass(frozen=True)
class Continued(Sampler):
    """A sampler that starts at time t from a mixture of noise and a guess (B, d)."""

    inner: Any
    t: float
    guess: Tensor

    @property
    def training(self) -> str:
        """That of the sampler it continues."""
        return str(self.inner.training)

    @property
    def nfe(self) -> int:
        """Those of the sampler it continues."""
        return int(self.inner.nfe)

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        if isinstance(self.inner, MeanSampler):
            return self.inner(network, noise, c) + self.t * noise[0]
        if self.inner.family != "diffusion":
            x = (1 - self.t) * noise[0] + self.t * self.guess
            jumps = isinstance(self.inner, JumpSampler)
            velocity = network if jumps else velocity_of(network, self.inner.prediction)
            for now, after in pairwise(torch.linspace(self.t, 1, self.nfe + 1)):
                x = x + (after - now) * velocity(now, x, c, *[after - now] * jumps)
            return x
        model = diffusion_of("data", self.inner.levels, self.inner.clip)
        first = round((1 - self.t) * model.levels)
        levels = [round(first * (self.nfe - i) / self.nfe) - 1 for i in range(self.nfe)]
        signal = [math.sqrt(float(model.alphas_cumprod[k])) for k in levels] + [1.0]
        x0, x1 = noise[0], self.guess
        for k, s in zip(levels, signal, strict=False):
            x = s * x1 + math.sqrt(1 - s * s) * x0
            x1 = network(torch.tensor(k / model.levels), x, c).clamp(-model.clip, model.clip)
            x0 = (x - s * x1) / math.sqrt(1 - s * s)
        return x1


class WarmStarted:
    """A policy for one rollout that remembers its last plans.

    Args:
        policy: with its number of actions, sampler and temperature.
        t: where a plan starts; 0 starts from noise.
        older: what is executed is a mean of all plans for that step, and each has so much of the
            weight of the next one; 0 executes the newest.
    """

    def __init__(self, policy: ChunkPolicy, t: float, older: float = 0.0) -> None:
        self.policy, self.t, self.older = policy, t, older
        self.windows, self.execute = policy.windows, policy.execute
        self.plans, self.sums, self.weights = np.zeros(0), np.zeros(0), np.zeros(0)

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """The noise of the policy; the last column is the number of the episode."""
        noise = self.policy.noise(n, generator)[:1]
        return torch.cat([noise, torch.arange(n)[None, :, None].expand(1, n, 1)], dim=2)

    def act(self, history: Any, *, noise: Tensor) -> Any:
        """The next actions (B, execute, A)."""
        episode, noise = noise[0, :, -1].long().numpy(), noise[:, :, :-1]
        guess, t, windows = torch.zeros_like(noise[0]), 0.0, self.windows
        if len(self.plans):
            left = self.plans[episode, self.execute :]
            left = np.concatenate([left, np.repeat(left[:, -1:], self.execute, axis=1)], axis=1)
            guess, t = windows.chunks(left, history), self.t
        if isinstance(self.policy.sampler, MeanSampler):
            t = self.t
        sampler = Continued(self.policy.sampler, t, guess)
        x = replace(self.policy, sampler=sampler).draw(noise, windows.condition(history))
        actions = windows.actions(x, history).clip(*windows.task.action_limits)
        if not len(self.plans):
            self.plans, self.sums = np.zeros((2, *actions.shape))
            self.weights = np.zeros((len(actions), actions.shape[1], 1))
        self.plans[episode] = actions
        for kept, new in ((self.sums, actions), (self.weights, 1.0)):
            shifted = np.zeros_like(kept[episode])
            shifted[:, : -self.execute] = kept[episode, self.execute :]
            kept[episode] = self.older * shifted + new
        mean = self.sums[episode] / self.weights[episode]
        return mean[:, : self.execute]


def main() -> None:
    """Fills the table of a task."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("task", help="a task of own_settings.py")
    asked = parser.parse_known_args()[0]
    name = f"own_settings_{asked.task.replace('-', '_')}"
    own = read_json(RESULTS / f"{name}.json", "protocol")
    trials, episodes = own["protocol"]["trials"], own["protocol"]["episodes"]

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        stem, cells = f"{key['method']}-{key['seed']}", Path(__file__).parent / "results" / name
        chosen = read_json(cells / f"{stem}.json")["samplers"][key["sampler"]]
        loaded = ChunkPolicy.load(Path("build") / name / f"{stem}.safetensors")
        drawn = next(s for s in loaded.sampler.variants if s.name == key["sampler"])
        kept = {what: chosen[what] for what in ("execute", "temperature")}
        policy = replace(loaded, sampler=drawn, **kept)

        def run(t: float, **starts: Any) -> tuple[Rollouts, Any, Any]:
            done = rollout(WarmStarted(policy, t), progress=False, **starts)
            return done, done[done.task.strictest], done[done.task.score]

        tried = {t: tuple(float(s.mean()) for s in run(t, episodes=trials)[1:]) for t in STARTS}
        best = max(tried, key=lambda t: tried[t])
        done, won, score = run(best, seeds=range(REPORTED, REPORTED + episodes))
        return {
            **kept,
            "t": best,
            "success": float(won.mean()),
            "success_interval": wilson_interval(int(won.sum()), len(won)),
            "score": float(score.mean()),
            "without": chosen["summary"][done.task.strictest],
            "tried": {f"{t:g}": won for t, (won, _) in tried.items()},
            "jerk": float(done.jerk.mean()),
        }

    table = opened(
        __doc__ or "",
        {"starts": STARTS, "trials": trials, "episodes": episodes, "first_start": REPORTED},
        parser=parser,
        name=f"warm_start_{asked.task.replace('-', '_')}",
    )
    table.fill(
        [
            {"method": row["method"], "seed": seed, "sampler": row["sampler"]}
            for row in own["rows"]
            for seed in row["seeds"]
            if row["nfe"] < 3 and row["method"] != "minibatch_ot"
        ],
        compute,
    )


if __name__ == "__main__":
    main()
