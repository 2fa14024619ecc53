"""What do pairs cost, in time and memory, if the data lie in a memory-mapped file?

The data are written to files of float32 in a temporary folder (1.4 GB for 10^7 rows), and each
coupling streams pairs from them in a process of its own. `stratified` and `semidiscrete` pair what
they draw, a block of rows; `stratified, all rows` pairs whole epochs, and is left out for 10^7.

`start_seconds`: from the opened file to the first batch, with checks, k-means, the fit of the
potential and the first block. `microseconds_per_pair`: after that, of 400 batches or one block.
Both are CPU time of one thread. `peak_mb`: the largest resident size of the process, Python, its
libraries and pages of the file included; `own_peak_mb`: without pages of files, which the system
takes back when memory is short. It needs Linux.

    python benchmarks/larger_than_memory.py     # TMPDIR says where the files go
"""

import multiprocessing
import tempfile
import threading
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import opened
from whole_data import CONDITION_DIM, DIM, ROWS_PER_CLUSTER

from cotlearn.couplings import ConditionalOT, Pairs, SemidiscreteOT, StratifiedOT
from cotlearn.datasets import Dataset

BATCH, BATCHES = 256, 400  #: rows of a batch, and batches that are timed
BLOCKS = {"stratified": 200_000, "semidiscrete": 20_000}  #: rows that are paired at once
SEMIDISCRETE_CLUSTERS = 64


def write(folder: Path, rows: int) -> None:
    """Data around a linear function of smooth conditions, written in parts."""
    rng = np.random.default_rng(0)
    slope = rng.standard_normal((CONDITION_DIM, DIM), dtype=np.float32)
    shapes = {"x1": (rows, DIM), "c": (rows, CONDITION_DIM)}
    files = {
        name: np.lib.format.open_memmap(folder / f"{name}.npy", "w+", np.float32, shape)
        for name, shape in shapes.items()
    }
    for start in range(0, rows, 100_000):
        part = slice(start, start + 100_000)
        c = files["c"][part] = rng.standard_normal((100_000, CONDITION_DIM), np.float32)
        noise = rng.standard_normal((100_000, DIM), np.float32)
        files["x1"][part] = 0.5 * noise + c @ slope


def read(folder: Path) -> Dataset:
    """The data, mapped; mode "c" never writes to the file."""
    arrays = (np.load(folder / f"{name}.npy", mmap_mode="c") for name in ("x1", "c"))
    return Dataset(*map(torch.from_numpy, arrays))


def pairs_of(name: str, data: Dataset) -> Iterator[Pairs]:
    """The stream of this name."""
    g = torch.Generator().manual_seed(0)
    if name == "semidiscrete":
        data = Dataset(*data.sample(BLOCKS[name], g))
        coupling = SemidiscreteOT(1.0, clusters=SEMIDISCRETE_CLUSTERS)
        return coupling.stream(data, batch_size=BATCH, generator=g)
    if name == "conditional_ot":
        return ConditionalOT().stream(data, batch_size=BATCH, generator=g)
    block = BLOCKS.get(name)
    stratified = StratifiedOT((block or len(data)) // ROWS_PER_CLUSTER, n_samples=block)
    return stratified.stream(data, batch_size=BATCH, generator=g)


def status_mb(name: str) -> float:
    """What Linux says of this process's memory (`getrusage` would also know its parent's peak)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 2**10 for line in lines if line.startswith(name))


def stream(folder: Path, name: str) -> dict[str, Any]:
    """Time and memory of the first batches."""
    peaks, done = [0.0], threading.Event()

    def watch() -> None:
        while not done.wait(0.02):
            peaks.append(max(peaks[-1], status_mb("RssAnon")))

    thread = threading.Thread(target=watch)
    thread.start()
    started = time.process_time()
    data = read(folder)
    batches = pairs_of(name, data)
    next(batches)
    first = time.process_time() - started
    whole = len(data) if name == "stratified, all rows" else BLOCKS.get(name, 0)
    number = BATCHES if name == "semidiscrete" else max(BATCHES, whole // BATCH)
    started = time.process_time()
    for _ in islice(batches, number):  # up to the first batch of another block
        pass
    seconds = time.process_time() - started
    done.set()
    thread.join()
    return {
        "start_seconds": round(first, 1),
        "microseconds_per_pair": round(1e6 * seconds / (BATCH * number), 1),
        "rows_paired_at_once": whole or BATCH,
        "peak_mb": round(status_mb("VmHWM")),
        "own_peak_mb": round(peaks[-1]),
        "data_mb": round(sum(file.stat().st_size for file in folder.iterdir()) / 2**20),
    }


def measure(key: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The cell of a key, in its own process."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(1, initializer=torch.set_num_threads, initargs=(1,)) as pool:
        return pool.apply(stream, (folder, key["coupling"]))


def main() -> None:
    """Fill the table."""
    table = opened(
        "What do pairs cost if the data lie in a memory-mapped file?",
        {
            "dim": DIM,
            "condition_dim": CONDITION_DIM,
            "batch": BATCH,
            "rows_per_cluster": ROWS_PER_CLUSTER,
            "semidiscrete_clusters": SEMIDISCRETE_CLUSTERS,
        },
    )
    for rows in (100_000, 1_000_000, 10_000_000):
        names = ["conditional_ot", *BLOCKS]
        if rows < 10_000_000:
            names.append("stratified, all rows")
        keys = [{"coupling": name, "rows": rows} for name in names]
        with tempfile.TemporaryDirectory(prefix="cotlearn ") as folder:
            if not all(table.holds(key) for key in keys):
                write(Path(folder), rows)
            table.fill(keys, lambda key, place=Path(folder): measure(key, place))


if __name__ == "__main__":
    main()
