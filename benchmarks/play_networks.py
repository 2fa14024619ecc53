"""Trains the small networks of the playground, and writes them in 16 bits.

One network for each of three mixtures and each coupling: independent pairs, and conditional OT with
the weights 0 (naive OT) to infinity. About four CPU minutes.

    python benchmarks/play_networks.py
    python -m cotlearn.course
"""

import torch

from cotlearn.course.assets import data_folder
from cotlearn.play.networks import DATA, FILE, couplings, train
from cotlearn.storage import save_tensors


def main() -> None:
    """Trains all, and writes the file."""
    torch.set_num_threads(1)
    tensors = {}
    for name, make in DATA.items():
        for key, coupling in couplings(make()).items():
            print(name, key, flush=True)
            for part, value in train(name, coupling).state_dict().items():
                tensors[f"{name} {key} {part}"] = value.half()
    path = data_folder() / FILE
    save_tensors(path, tensors, {})
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
