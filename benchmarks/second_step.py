"""Where should the second of two evaluations be?

Two Euler steps evaluate the network at t = 0 and t = 1/2, two DDIM steps at all of the noise and at
half of the levels. Here the second evaluation comes earlier or later. Policies of `cotlearn bench`
are trained again, once each and one of them twice; 100 exploration starts choose the place by
successes (ties: the nearest to the middle), and the starts that the tables report say what it
brings.

    python benchmarks/second_step.py

writes data/results/second_step.json. An interrupted run goes on.
"""

from dataclasses import dataclass, replace
from typing import Any

import torch
from cells import opened
from torch import Tensor, nn

from cotlearn.assets import find_data
from cotlearn.flows.matching import velocity_of
from cotlearn.policies.comparison.choice import with_choice
from cotlearn.policies.methods import METHODS
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.policies.samplers import DDIMSampler, DDPMSampler, FlowSampler, Sampler, diffusion_of
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import train
from cotlearn.robots.episodes import read, split
from cotlearn.robots.registry import find_task

PLACES = (0.25, 0.375, 0.5, 0.625, 0.75, 0.875)
PROTOCOL: dict[str, Any] = {
    "places": PLACES,
    "trials": 100,
    "episodes": 200,
    "first_start": REPORTED,
}
#: Task, method and what the network predicts.
CELLS = [
    ("arm-avoid", "independent", "velocity"),
    ("arm-avoid", "diffusion", "velocity"),
    ("arm-avoid", "residual", "velocity"),
    ("arm-avoid", "diffusion_residual", "data"),
]


@dataclass(frozen=True)
class TwoEuler(FlowSampler):
    """Two Euler steps, to a time and from there to t = 1."""

    nfe: int = 2
    second: float = 0.5

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        velocity, x, t = velocity_of(network, self.prediction), noise[0], torch.tensor(self.second)
        with torch.no_grad():
            x = x + t * velocity(torch.zeros(()), x, c)
            return x + (1 - t) * velocity(t, x, c)


@dataclass(frozen=True)
class TwoDDIM(DDIMSampler):
    """Two DDIM steps, to a level of noise and from there to the data."""

    nfe: int = 2
    second: float = 0.5

    def __call__(self, network: nn.Module, noise: Tensor, c: Tensor) -> Tensor:
        """Chunks (B, d) from noise (1, B, d) under conditions c (B, k)."""
        model = diffusion_of(self.prediction, self.levels, self.clip)
        level = round(self.levels * (1 - self.second)) - 1
        a = float(model.alphas_cumprod[level])
        with torch.no_grad():
            x1, x0 = model._split(network, self.levels - 1, noise[0], c)
            return model._split(network, level, a**0.5 * x1 + (1 - a) ** 0.5 * x0, c)[0]


def two_steps(sampler: Sampler, second: float) -> Sampler:
    """The sampler of a policy as trained, with two evaluations."""
    if isinstance(sampler, FlowSampler):
        return TwoEuler(prediction=sampler.prediction, second=second)
    assert isinstance(sampler, DDPMSampler)
    return TwoDDIM(clip=sampler.clip, prediction=sampler.prediction, second=second)


def main() -> None:
    """Fills the table."""

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        task, method, prediction, seed = key.values()
        setting = SETTINGS[task]
        episodes = read(find_data(find_task(setting.task).demonstrations))
        training = split(episodes, held_out=setting.held_out)[0]
        options = replace(setting.options, prediction=prediction)
        options = with_choice(METHODS[method], training, options)
        policy = train(method, training, seed=seed, options=options).policy

        def successes(second: float, **of: Any) -> float:
            moved = policy.with_sampler(two_steps(policy.sampler, second))
            return float(rollout(moved, **of)["success"].mean())

        found = {second: successes(second, episodes=PROTOCOL["trials"]) for second in PLACES}
        best = max(PLACES, key=lambda second: (found[second], -abs(second - 0.5)))
        starts = range(REPORTED, REPORTED + PROTOCOL["episodes"])
        return {
            "tried": {f"{second:g}": round(rate, 4) for second, rate in found.items()},
            "chosen": best,
            "success": {f"{s:g}": successes(s, seeds=starts) for s in sorted({0.5, best})},
        }

    table = opened(__doc__ or "", PROTOCOL)
    names = ("task", "method", "predicts")
    keys = [dict(zip(names, cell, strict=True)) for cell in CELLS]
    table.fill([*({**key, "seed": 0} for key in keys), {**keys[0], "seed": 1}], compute)


if __name__ == "__main__":
    main()
