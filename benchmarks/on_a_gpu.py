"""What pairing costs beside a GPU: training steps, pairing, MeanFlow, rollouts.

    python benchmarks/on_a_gpu.py                      # about six minutes on a GPU
    python benchmarks/on_a_gpu.py --device cpu --tiny  # tries every part in a minute

prints one table as CSV, with the name of the card. Nothing is stored: the figures go into
docs/speed.md by hand, with that name.
"""

import argparse
import csv
import statistics
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch

from cotlearn.couplings import ConditionalOT, Coupling, Independent
from cotlearn.course.assets import find_data
from cotlearn.datasets import Dataset
from cotlearn.flows import conditional_flow_matching_loss, fit
from cotlearn.flows.networks import ResidualMLP
from cotlearn.flows.one_step import MeanFlow, MeanVelocity
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout

ROWS, DIM, CONDITION_DIM = 50_000, 32, 10
BATCHES, WIDTH, STEPS = (256, 1024, 4096), 512, 60
COUPLINGS: dict[str, Callable[[], Coupling]] = {
    "independent": Independent,
    "conditional_ot": ConditionalOT,
}
Result = tuple[str, str, int, float]  #: what, how, rows, milliseconds


def actions() -> Dataset:
    """Smooth conditions and chunks of actions that follow them."""
    g = torch.Generator().manual_seed(0)
    c = torch.randn(ROWS, CONDITION_DIM, generator=g)
    noise = torch.randn(ROWS, DIM, generator=g)
    return Dataset(c @ torch.randn(CONDITION_DIM, DIM, generator=g) + 0.5 * noise, c)


def training(device: str, batches: tuple[int, ...], steps: int) -> Iterator[Result]:
    """A step of `fit`, whose pairs are made in the background, and one of MeanFlow."""
    data = actions()
    losses: dict[str, Any] = {
        "training step": conditional_flow_matching_loss,
        "MeanFlow step": MeanFlow(),
    }
    for what, loss in losses.items():
        for rows in batches:
            for name, make in COUPLINGS.items():
                network: Any = ResidualMLP(DIM, CONDITION_DIM, width=WIDTH, seed=0)
                if what == "MeanFlow step":  # its network also sees the length of a jump
                    network = MeanVelocity(ResidualMLP(DIM, CONDITION_DIM + 1, width=WIDTH, seed=0))
                network = network.to(device)
                options: dict[str, Any] = {"steps": steps, "batch_size": rows, "loss": loss}
                done = fit(network, data, make(), log_every=steps // 3, progress=False, **options)
                spent = done.history["seconds"]
                yield what, name, rows, 1000 * float(spent[-1] - spent[0]) / (steps - steps // 3)


def pairing(device: str, batches: tuple[int, ...], steps: int) -> Iterator[Result]:
    """The pairs alone: the CPU's exact plan of rows on the device, and the cost on the device.

    What a solver on the device could win at most is the first time less the second.
    """
    data = actions()
    for rows in batches:
        x1, c = (value[:rows].to(device) for value in (data.x1, data.c) if value is not None)
        given = torch.randn_like(x1), x1, c
        yield "pairing", "exact, on the CPU", rows, median(ConditionalOT(), given, steps // 10)
        yield "cost matrix", f"on {device}", rows, median(cost, given, steps // 10)


def cost(x0: torch.Tensor, x1: torch.Tensor, c: torch.Tensor) -> torch.Tensor:
    """What a solver on the device would need first."""
    return torch.cdist(x0, x1).square() + torch.cdist(c, c).square()


def rollouts(episodes: int) -> Iterator[Result]:
    """Milliseconds of the network for each chunk in a rollout of Push-T."""
    policy = ChunkPolicy.load(find_data("weights/push_t_residual.safetensors"))
    done = rollout(policy, episodes=episodes, max_steps=40, progress=False)
    yield "rollout on cpu, one chunk", "push-t", episodes, 1000 * done.seconds / done.chunks


def median(function: Callable[..., Any], given: tuple[Any, ...], repetitions: int) -> float:
    """The median milliseconds of a function, whose first call is left out."""
    times = []
    for _ in range(max(3, repetitions) + 1):
        synchronise()
        started = time.perf_counter()
        function(*given)
        synchronise()
        times.append(1000 * (time.perf_counter() - started))
    return statistics.median(times[1:])


def synchronise() -> None:
    """Wait for the device, if there is one."""
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
    parser.add_argument("--tiny", action="store_true", help="small sizes, to try the script")
    chosen = parser.parse_args()
    batches, steps = ((64,), 6) if chosen.tiny else (BATCHES, STEPS)
    card = torch.cuda.get_device_name() if chosen.device.startswith("cuda") else "no GPU"
    table = csv.writer(sys.stdout)
    table.writerow(["what", "how", "rows", "ms", "card", "torch"])
    for part in (training, pairing):
        for what, how, rows, spent in part(chosen.device, batches, steps):
            table.writerow([what, how, rows, f"{spent:.2f}", card, torch.__version__])
            sys.stdout.flush()
    for what, how, rows, spent in rollouts(4 if chosen.tiny else 100):
        table.writerow([what, how, rows, f"{spent:.2f}", card, torch.__version__])


if __name__ == "__main__":
    main()
