"""Policies that use their last plans: as a guess for the new one, and in a mean of all plans.

Where a policy plans again, what is left of the last plan is a guess for the new one. A warm start
mixes it with the noise, as pairs at time t are mixed in training, and samples from t on
(2508.05396). A mean of all plans for a step is temporal ensembling (2304.13705).
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cotlearn.flows.matching import velocity_of
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.samplers import JumpSampler, MeanSampler, Sampler, diffusion_of


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
            velocity = velocity_of(network, self.inner.prediction)
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


class LastPlan:
    """A policy for one rollout that remembers its last plans.

    Args:
        policy: with its number of actions, sampler and temperature.
        t: where a plan starts; 0 starts from noise. A regression, which has none, adds so much
            normal noise to its chunks, in units of their deviation.
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

    def guess(self, episode: Any, history: Any) -> Tensor:
        """What is left of the last plans of episodes (B,), as chunks (B, d)."""
        left = self.plans[episode, self.execute :]
        left = np.concatenate([left, np.repeat(left[:, -1:], self.execute, axis=1)], axis=1)
        return self.windows.chunks(left, history)

    def act(self, history: Any, *, noise: Tensor) -> Any:
        """The next actions (B, execute, A)."""
        episode, noise = noise[0, :, -1].long().numpy(), noise[:, :, :-1]
        guess, t, windows = torch.zeros_like(noise[0]), 0.0, self.windows
        if len(self.plans):
            guess, t = self.guess(episode, history), self.t
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
