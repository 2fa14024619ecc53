"""LeRobot's diffusion policy as a flow on our demonstrations of Push-T, with and without pairs.

The demonstrations are written in LeRobot's layout and read by its own data set class; its policy,
preprocessor, optimizer and schedule train it. Needs LeRobot (`make bridge`):

    python benchmarks/lerobot_push_t.py

prints the energy score of held-out chunks, in scaled actions, and the success of rollouts, at one
and at ten evaluations.
"""

import argparse
import tempfile
from itertools import cycle, islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from lerobot.configs.types import FeatureType
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.datasets.utils import dataset_to_policy_features
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy
from lerobot.policies.factory import make_pre_post_processors
from torch.utils.data import DataLoader

from cotlearn.bridge import PairedNoise, pair_lerobot
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT
from cotlearn.course.assets import find_data
from cotlearn.metrics import energy_score
from cotlearn.policies.rollout import rollout
from cotlearn.robots.episodes import read, write_lerobot
from cotlearn.robots.registry import find_task

TASK = find_task("push-t")
HORIZON, EXECUTE, OBSERVE, BATCH = 16, 8, 2, 64
COUPLINGS = {"independent": Independent, "conditional_ot": ConditionalOT, "naive": MinibatchOT}
EPISODES = 210  #: about as many as lerobot/pusht has
HELD_OUT, DRAWS, SCORED = 10, 8, 512  #: episodes; draws and states of the energy score


class Acting:
    """A policy of LeRobot for `rollout`."""

    windows, execute = SimpleNamespace(task=TASK, observe=OBSERVE), EXECUTE

    def __init__(self, policy: Any, before: Any, after: Any) -> None:
        self.policy, self.before, self.after = policy, before, after

    def noise(self, n: int, generator: torch.Generator | None = None) -> torch.Tensor:
        """Noise of a chunk for n rows, (1, n, d)."""
        return torch.randn(1, n, HORIZON * 2, generator=generator)

    @torch.no_grad()
    def act(self, history: Any, *, noise: torch.Tensor) -> Any:
        """Actions (B, EXECUTE, 2) from states (B, OBSERVE, 5)."""
        history = np.asarray(history)
        seen = TASK.lerobot.observations(history.reshape(-1, history.shape[-1]))
        batch = {
            name: torch.tensor(values, dtype=torch.float32).view(len(history), OBSERVE, -1)
            for name, values in seen.items()
        }
        noise = noise[0].view(-1, HORIZON, 2)
        actions = self.policy.diffusion.generate_actions(self.before(batch), noise=noise)
        return self.after(actions).numpy().astype(np.float64).clip(*TASK.action_limits)


def main(steps: int, episodes: int, names: list[str], evaluations: tuple[int, ...]) -> None:
    """Train each coupling from the same weights, and print its scores."""
    folder = Path(tempfile.mkdtemp()) / "push_t"
    demonstrations = read(find_data("push_t_demos.npz")).select(range(EPISODES))
    write_lerobot(folder, demonstrations)
    last = len(demonstrations) - HELD_OUT
    train, held = data(folder, range(last)), data(folder, range(last, len(demonstrations)))
    for name in names:
        policy, before, after = untrained(train)
        pairing = PairedNoise(COUPLINGS[name]())
        pair_lerobot(policy, pairing)
        fit(policy, before, train, steps)
        print(name, "skew", round(pairing.skew().explained, 4), flush=True)
        for nfe in evaluations:
            with pair_lerobot(policy, pairing, nfe=nfe):
                score = held_out_score(policy, before, held)
                done = rollout(Acting(policy, before, after), episodes=episodes, progress=False)
            print(f"{name}, {nfe}: score {score:.3f}, {done.summary()}", flush=True)


def data(folder: Path, episodes: range) -> Any:
    """Some episodes, with windows of observations and actions."""
    offsets = [step / 10 for step in range(1 - OBSERVE, 1 - OBSERVE + HORIZON)]
    windows = {
        "action": offsets,
        "observation.state": offsets[:OBSERVE],
        "observation.environment_state": offsets[:OBSERVE],
    }
    return LeRobotDataset(
        "local/push_t", root=folder, episodes=list(episodes), delta_timestamps=windows
    )


def untrained(rows: Any) -> tuple[Any, Any, Any]:
    """The policy with seeded weights, its preprocessor and its postprocessor."""
    torch.manual_seed(0)
    features = dataset_to_policy_features(rows.meta.features)
    config = DiffusionConfig(
        input_features={k: v for k, v in features.items() if v.type is not FeatureType.ACTION},
        output_features={k: v for k, v in features.items() if v.type is FeatureType.ACTION},
        horizon=HORIZON,
        n_action_steps=EXECUTE,
        n_obs_steps=OBSERVE,
        down_dims=(64, 128),
        device="cpu",
    )
    return DiffusionPolicy(config), *make_pre_post_processors(config, dataset_stats=rows.meta.stats)


def fit(policy: Any, before: Any, rows: Any, steps: int) -> None:
    """LeRobot's optimizer and schedule; the same batches for each coupling."""
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    schedule = policy.config.get_scheduler_preset().build(optimizer, steps)
    order = torch.Generator().manual_seed(0)
    loader = DataLoader(rows, BATCH, shuffle=True, drop_last=True, generator=order)
    policy.train()
    torch.manual_seed(0)
    for step, batch in enumerate(islice(cycle_of(loader), steps)):
        loss, _ = policy.forward(before(batch))
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        schedule.step()
        if step % 250 == 0:
            print(f"  step {step}: loss {float(loss.detach()):.3f}", flush=True)
    policy.eval()


def cycle_of(loader: Any) -> Any:
    """Epoch after epoch, each in a new order."""
    for _ in cycle([0]):
        yield from loader


@torch.no_grad()
def held_out_score(policy: Any, before: Any, held: Any) -> float:
    """The energy score of scaled chunks at held-out states."""
    order = torch.Generator().manual_seed(0)
    batch = before(next(iter(DataLoader(held, SCORED, shuffle=True, generator=order))))
    seen = policy.diffusion._prepare_global_conditioning(batch)
    noise = torch.randn(DRAWS, len(seen), HORIZON, 2, generator=torch.Generator().manual_seed(1))
    draws = [policy.diffusion.conditional_sample(len(seen), seen, noise=one) for one in noise]
    return energy_score(torch.stack(draws).flatten(2), batch["action"].flatten(1))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--couplings", nargs="+", default=["independent", "conditional_ot"])
    parser.add_argument("--evaluations", type=int, nargs="+", default=[1, 10])
    chosen = parser.parse_args()
    main(chosen.steps, chosen.episodes, chosen.couplings, tuple(chosen.evaluations))
