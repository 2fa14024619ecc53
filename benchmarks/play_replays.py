"""Records what the playground's robots replay: the shipped policies, from the same starts.

Push-T and the arm, three methods, three numbers of evaluations; and forty draws of the arm from
one start. About two CPU minutes.

    python benchmarks/play_replays.py
"""

import gzip
import json

import torch

from cotlearn.course.assets import data_folder, find_data
from cotlearn.play.replay import FILE, TASKS, compare, record, with_nfe
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import EXPLORATION

METHODS = ("independent", "minibatch_ot", "residual")
EVALUATIONS = (1, 2, 16)
STARTS = {"push-t": 3, "arm-ring": 4}  #: the first of exploration, none selected
DRAWS = 40


def policies(name: str) -> dict[str, ChunkPolicy]:
    """The shipped policies of a task."""
    file = name.replace("-", "_")
    return {m: ChunkPolicy.load(find_data(f"weights/{file}_{m}.safetensors")) for m in METHODS}


def main() -> None:
    """Records all, and writes the file."""
    torch.set_num_threads(1)
    tasks = {}
    for name in TASKS:
        print(name, flush=True)
        starts = range(EXPLORATION, EXPLORATION + STARTS[name])
        tasks[name] = compare(name, policies(name), EVALUATIONS, starts)
    forty = {
        method: {
            str(nfe): record(with_nfe(made, nfe), [EXPLORATION] * DRAWS, with_chunks=False)
            for nfe in EVALUATIONS
        }
        for method, made in policies("arm-ring").items()
    }
    path = data_folder() / FILE
    text = json.dumps({"tasks": tasks, "forty": forty}, separators=(",", ":"))
    path.write_bytes(gzip.compress(text.encode(), mtime=0))
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
