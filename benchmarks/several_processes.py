"""What does it cost two processes to pair their own batches, or their joint batch?

The pairs of one step: `own`, a batch of the rank's B / 2 rows; `joint`, the whole joint batch of B
rows on each rank, of which it takes its share; `gathered`, the same for rows that each rank has to
send first; `scattered`, rank 0 alone solves and sends the plan. Ranks are processes of one machine
that talk by gloo; docs/how_to/train_on_several_gpus.md has the code. `cpu_milliseconds` of a step
are the mean of both ranks, the median over steps; `fastest_milliseconds` is the shortest step, with
waiting. `candidates` is what a noise row can choose from.

    python benchmarks/several_processes.py
"""

import os
import tempfile
import time
from typing import Any

import torch
import torch.distributed as dist
import torch.multiprocessing
from cells import opened
from whole_data import CONDITION_DIM, DIM, clustered

from cotlearn.couplings import ConditionalOT
from cotlearn.datasets import Dataset

RANKS, STEPS, ROWS = 2, 30, 20_000
WEIGHT = 1.0  #: condition weight
WAYS = ("own", "joint", "gathered", "scattered")


def pair(
    way: str, joint: int, data: Dataset, own: torch.Generator, same: torch.Generator
) -> torch.Tensor:
    """The rows that this rank's noise is paired with, for one step."""
    rank, coupling = dist.get_rank(), ConditionalOT(WEIGHT)
    if way == "own":
        x1, c = data.sample(joint // RANKS, own)
        return coupling(torch.randn(x1.shape, generator=own), x1, c, own).x1
    if way == "joint":
        x1, c = data.sample(joint, same)
    else:
        rows = torch.cat(data.sample(joint // RANKS, own), dim=1)
        every = [torch.empty_like(rows) for _ in range(RANKS)]
        dist.all_gather(every, rows)
        x1, c = torch.cat(every).split([DIM, CONDITION_DIM], dim=1)
    x0 = torch.randn(x1.shape, generator=same)
    plan = torch.empty(joint, dtype=torch.long)
    if way != "scattered" or rank == 0:
        plan = coupling(x0, x1, c, same).target_index
    if way == "scattered":
        dist.broadcast(plan, 0)
    return x1[plan[rank::RANKS]]


def work(rank: int, way: str, joint: int, folder: str) -> None:
    """One rank: times the steps and leaves the milliseconds in a file."""
    torch.set_num_threads(1)
    dist.init_process_group(
        "gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=RANKS
    )
    own, same, seconds = torch.Generator().manual_seed(1 + rank), torch.Generator(), []
    data = clustered(ROWS)
    for step in range(STEPS + 3):  # three to compile and to warm up
        dist.barrier()
        started, cpu = time.perf_counter(), time.process_time()
        pair(way, joint, data, own, same.manual_seed(step))
        seconds.append((time.perf_counter() - started, time.process_time() - cpu))
    torch.save(torch.tensor(seconds[3:]), f"{folder}/{rank}.pt")
    dist.destroy_process_group()


def measure(key: dict[str, Any]) -> dict[str, Any]:
    """The cell of a key."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = (key["way"], key["joint"], folder)
        torch.multiprocessing.spawn(work, arguments, nprocs=RANKS)
        each = [torch.load(f"{folder}/{rank}.pt") for rank in range(RANKS)]
    wall, cpu = torch.stack(each, dim=-1).unbind(dim=1)  # (steps, ranks)
    rows = key["joint"] // (RANKS if key["way"] == "own" else 1)
    x1, c = clustered(ROWS).sample(rows, torch.Generator().manual_seed(0))
    candidates = ConditionalOT(WEIGHT).candidates(torch.randn_like(x1), x1, c)
    return {
        "cpu_milliseconds": round(1e3 * float(cpu.mean(dim=1).median()), 1),
        "fastest_milliseconds": round(1e3 * float(wall.amax(dim=1).min()), 1),
        "candidates": round(candidates, 1),
    }


def main() -> None:
    """Fill the table."""
    table = opened(
        "What does it cost two processes to pair their own batches, or their joint batch?",
        {
            "ranks": RANKS,
            "steps": STEPS,
            "dim": DIM,
            "condition_dim": CONDITION_DIM,
            "condition_weight": WEIGHT,
        },
    )
    os.environ["OMP_NUM_THREADS"] = "1"
    table.fill([{"joint": b, "way": way} for b in (256, 1024) for way in WAYS], measure)


if __name__ == "__main__":
    main()
