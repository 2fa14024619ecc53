"""What do pairs give LeRobot's own diffusion policy on our demonstrations of Push-T?

`DiffusionPolicy` becomes a flow (`pair_lerobot`), and LeRobot does the rest: 500 demonstrations are
written in its layout and read by its data set class, and its preprocessor, optimizer and schedule
train 2,000 steps of 64 windows. One seed; each coupling starts from the same weights and sees the
same batches. The windows are read once and kept in memory.

Three couplings pair the rows of a batch. `stratified` pairs all windows anew in each epoch, in 512
clusters of states that are fitted once, and a batch is given the noise of its rows.

The scores, at one and at ten evaluations: the energy score of held-out chunks, in scaled actions,
and success and best coverage of 100 rollouts with the same starts and noise.

It needs LeRobot, which `make bridge` brings, three CPU minutes to read the windows, and less than
two for each coupling:

    build/bridge/bin/python benchmarks/in_lerobot.py

writes data/results/in_lerobot.csv cell by cell; a run that was stopped goes on where it was.
"""

import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from cells import opened
from torch import Tensor
from torch.utils.data import BatchSampler, DataLoader, SubsetRandomSampler

from cotlearn.bridge import PairedNoise, pair_lerobot, paired_noise
from cotlearn.couplings import (
    ConditionalOT,
    Coupling,
    Independent,
    MinibatchOT,
    StratifiedOT,
)
from cotlearn.course.assets import find_data
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import linear_skew
from cotlearn.metrics import energy_score
from cotlearn.policies.rollout import REPORTED, rollout
from cotlearn.robots.episodes import read, write_lerobot
from cotlearn.robots.registry import find_task

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
import peers

peers.lerobot()  # before what follows: torchvision may be built for another torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset  # noqa: E402
from lerobot.datasets.sampler import EpisodeAwareSampler  # noqa: E402
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig  # noqa: E402
from lerobot.policies.diffusion.modeling_diffusion import DiffusionPolicy  # noqa: E402
from lerobot.policies.factory import (  # noqa: E402
    dataset_to_policy_features,  # its own place is another in 0.6
    make_pre_post_processors,
)

TASK = find_task("push-t")
NFE = (1, 10)
EPISODES, HELD_OUT, STEPS, BATCH = 500, 50, 2000, 64
STRATA, CELLS, SKEW_ROWS = 512, 64, 20_000
SCORED, DRAWS, ROLLOUTS = 512, 8, 100  #: states and draws of the energy score
POLICY: dict[str, Any] = {
    "horizon": 16,
    "n_action_steps": 8,
    "n_obs_steps": 2,
    "down_dims": (32, 64),
    "optimizer_lr": 1e-3,  # its 1e-4 is for 100 times as many steps
    "scheduler_warmup_steps": 100,
    "normalization_mapping": dict.fromkeys(("STATE", "ENV", "ACTION"), "MIN_MAX"),  # ENV was not
}
PROTOCOL = {
    "lerobot": version("lerobot"),
    "policy": POLICY,
    "episodes": EPISODES,
    "held_out": HELD_OUT,
    "steps": STEPS,
    "batch_size": BATCH,
    "strata": STRATA,
    "scored_states": SCORED,
    "draws": DRAWS,
    "rollouts": ROLLOUTS,
    "first_start": REPORTED,
}
COUPLINGS: dict[str, type[Coupling]] = {
    "independent": Independent,
    "minibatch_ot": MinibatchOT,
    "conditional_ot": ConditionalOT,
    "stratified": StratifiedOT,
}
STARTS = range(REPORTED, REPORTED + ROLLOUTS)
STATES = ("observation.state", "observation.environment_state")
TWO_POINTS = [0, 1, -2, -1]  #: of the T's eight: they say its pose, and leave the agent its weight
NAMES = (*STATES, "action", "action_is_pad")
Rows = dict[str, Tensor]


class WholeData(PairedNoise):
    """Noise that a coupling paired with all windows at once, anew as soon as a row comes again.

    Its condition is the number of each row.
    """

    def __init__(self, coupling: Coupling, rows: Rows) -> None:
        self.actions, self.is_pad = rows["action"], rows["action_is_pad"]
        agent, points = (rows[name] for name in STATES)
        self.states = torch.cat([agent, points[..., TWO_POINTS]], dim=2).flatten(1)
        data, rng = Dataset(self.actions.flatten(1), self.states), torch.Generator().manual_seed(0)
        super().__init__(coupling.prepared(data, None, rng), generator=rng)
        self.used = torch.ones(len(data), dtype=torch.bool)
        self.drawn = torch.empty(0)

    def __call__(self, actions: Tensor, condition: Any = None, **_: Any) -> Tensor:
        """The noise of these rows."""
        if self.used[condition].any():
            options: Any = {"is_pad": self.is_pad, "generator": self.generator}
            self.drawn = paired_noise(self.coupling, self.actions, self.states, **options)
            self.used[:] = False
        self.used[condition] = True
        return self.drawn[condition]

    def skew(self) -> Any:
        """As of other pairs."""
        some = torch.randperm(len(self.drawn), generator=self.generator)[:SKEW_ROWS]
        return linear_skew(self.drawn[some].flatten(1), self.states[some], cells=CELLS)


class Acting:
    """A policy of LeRobot for `rollout`."""

    windows = SimpleNamespace(task=TASK, observe=POLICY["n_obs_steps"])
    execute = POLICY["n_action_steps"]

    def __init__(self, policy: Any, before: Any, after: Any) -> None:
        self.policy, self.before, self.after = policy, before, after

    def noise(self, n: int, generator: torch.Generator | None = None) -> Tensor:
        """Noise of a chunk for n rows, (1, n, d)."""
        return torch.randn(1, n, POLICY["horizon"] * 2, generator=generator)

    @torch.no_grad()
    def act(self, history: Any, *, noise: Tensor) -> Any:
        """Actions (B, execute, 2) from states (B, observe, 5)."""
        history = np.asarray(history)
        seen = TASK.lerobot.observations(history.reshape(-1, history.shape[-1]))
        batch = {
            name: torch.tensor(values, dtype=torch.float32).view(*history.shape[:2], -1)
            for name, values in seen.items()
        }
        noise = noise[0].view(len(history), POLICY["horizon"], 2)
        actions = self.policy.diffusion.generate_actions(self.before(batch), noise=noise)
        return self.after(actions).numpy().astype(np.float64).clip(*TASK.action_limits)


@cache
def windows() -> tuple[Any, Rows, Rows]:
    """What LeRobot knows of the demonstrations; windows to train on, and those held out."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "push_t"
        write_lerobot(root, read(find_data("push_t_demos.npz")).select(range(EPISODES)))
        offsets = [step / 10 for step in range(1 - POLICY["n_obs_steps"], POLICY["horizon"] - 1)]
        seen = dict.fromkeys(STATES, offsets[: POLICY["n_obs_steps"]])
        rows = LeRobotDataset(
            "local/push_t", root=root, delta_timestamps={"action": offsets} | seen
        )
        found = [
            stacked(rows, range(EPISODES - HELD_OUT)),
            stacked(rows, range(EPISODES - HELD_OUT, EPISODES)),
        ]
        return rows.meta, *found


def stacked(rows: Any, episodes: range) -> Rows:
    """The windows of some episodes; as in LeRobot's training, without the last of each."""
    first, last = (rows.meta.episodes[f"dataset_{end}_index"] for end in ("from", "to"))
    left_out = POLICY["horizon"] - POLICY["n_action_steps"] - POLICY["n_obs_steps"] + 1
    options: Any = {"episode_indices_to_use": list(episodes), "drop_n_last_frames": left_out}
    sampler = EpisodeAwareSampler(first, last, **options)
    batches = list(DataLoader(rows, 1024, sampler=sampler))
    return {name: torch.cat([batch[name] for batch in batches]) for name in NAMES}


def untrained(meta: Any) -> tuple[Any, Any, Any]:
    """The policy with seeded weights, its preprocessor and its postprocessor."""
    torch.manual_seed(0)
    inputs = dataset_to_policy_features(meta.features)
    outputs = {"action": inputs.pop("action")}
    config = DiffusionConfig(input_features=inputs, output_features=outputs, device="cpu", **POLICY)
    return DiffusionPolicy(config), *make_pre_post_processors(config, dataset_stats=meta.stats)


def batches(rows: int) -> Iterator[Tensor]:
    """Numbers of rows, epoch after epoch, each in a new order; the same for each coupling."""
    order = torch.Generator().manual_seed(0)
    sampler = SubsetRandomSampler(range(rows), generator=order)
    while True:
        yield from map(torch.tensor, BatchSampler(sampler, BATCH, drop_last=True))


def fit(policy: Any, rows: Rows) -> None:
    """LeRobot's optimizer and schedule."""
    optimizer = policy.config.get_optimizer_preset().build(policy.get_optim_params())
    schedule = policy.config.get_scheduler_preset().build(optimizer, STEPS)
    policy.train()
    torch.manual_seed(0)
    for step, some in zip(range(STEPS), batches(len(rows["action"])), strict=False):
        batch = {name: values[some] for name, values in rows.items()}
        loss, _ = policy.forward(batch | {"row": some})
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(policy.parameters(), 10.0)
        optimizer.step()
        schedule.step()
        if step % 100 == 0:
            print(f"  step {step}: loss {float(loss.detach()):.3f}", flush=True)
    policy.eval()


def compute(key: dict[str, Any]) -> dict[str, Any]:
    """One policy, trained and scored."""
    meta, *both = windows()
    policy, before, after = untrained(meta)
    train, held = ({name: before(rows)[name] for name in NAMES} for rows in both)
    coupling, whole = COUPLINGS[key["coupling"]], key["coupling"] == "stratified"
    pairing = WholeData(coupling(STRATA), train) if whole else PairedNoise(coupling())
    with pair_lerobot(policy, pairing, condition=(lambda b: b["row"]) if whole else None):
        fit(policy, train)
    found: dict[str, Any] = {"skew": round(pairing.skew().explained, 4)}
    for nfe in NFE:
        with pair_lerobot(policy, pairing, nfe=nfe):
            done = rollout(Acting(policy, before, after), seeds=STARTS, progress=False)
            scores = {"energy_score": held_out_score(policy, held)}
        scores |= {name: float(done[name].mean()) for name in ("success_95", "coverage")}
        for name, value in scores.items():
            found.setdefault(name, {})[nfe] = round(value, 4)
    return found


@torch.no_grad()
def held_out_score(policy: Any, held: Rows) -> float:
    """The energy score of scaled chunks at held-out states, with the same noise for each policy."""
    rng = torch.Generator().manual_seed(0)
    some = torch.randperm(len(held["action"]), generator=rng)[:SCORED]
    seen = policy.diffusion._prepare_global_conditioning({k: held[k][some] for k in STATES})
    truth = held["action"][some]
    noise = torch.randn(DRAWS, *truth.shape, generator=rng)
    draws = [policy.diffusion.conditional_sample(SCORED, seen, noise=one) for one in noise]
    return energy_score(torch.stack(draws).flatten(2), truth.flatten(1))


def main() -> None:
    """Fill the table."""
    table = opened(__doc__, PROTOCOL, axis="nfe")
    table.fill([{"coupling": name, "seed": 0} for name in COUPLINGS], compute)


if __name__ == "__main__":
    main()
