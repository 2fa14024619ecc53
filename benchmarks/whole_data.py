"""What does it cost to pair with the whole data set instead of a batch: time and memory?

`stratified`: pairs a second of `StratifiedOT`, once the clusters are fitted, and the seconds that
fitting takes. `semidiscrete`: microseconds for one pair of `SemidiscreteOT` against the number of
rows N it searches, without clusters and with clusters of about 1,000 rows. What a search costs does
not depend on the potential, so that it is 0 here and nothing is fitted.

Each cell runs in a process of its own. Its memory is the largest resident size while it paired
less the size before, data included; the resident size is Linux's or macOS's.

    python benchmarks/whole_data.py
"""

import multiprocessing
import sys
import time
from typing import Any

import torch
from cells import opened

from cotlearn.couplings import SemidiscreteOT, StratifiedOT
from cotlearn.datasets import Dataset

DIM, CONDITION_DIM = 32, 4
BATCH, PAIRS = 1000, 20_000  # timed pairs of the semidiscrete search
ROWS_PER_CLUSTER = 1000


def resident_mb() -> float:
    """The largest resident size of this process so far."""
    import resource

    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest / (2**20 if sys.platform == "darwin" else 2**10)


def clustered(rows: int) -> Dataset:
    """Data around a linear function of smooth conditions."""
    g = torch.Generator().manual_seed(0)
    c = torch.randn(rows, CONDITION_DIM, generator=g)
    x1 = torch.randn(rows, DIM, generator=g)
    x1 = 0.5 * x1 + c @ torch.randn(CONDITION_DIM, DIM, generator=g)
    return Dataset(x1, c, name=f"{rows} rows")


def stratified(rows: int, clusters: int) -> dict[str, Any]:
    """One epoch to warm up and fit, two that are timed."""
    before = resident_mb()
    data, coupling = clustered(rows), StratifiedOT(clusters)
    stream = coupling.stream(data, batch_size=BATCH, generator=torch.Generator().manual_seed(0))
    started = time.perf_counter()
    next(stream)
    first = time.perf_counter() - started
    for _ in range(rows // BATCH - 1):
        next(stream)
    started = time.perf_counter()
    for _ in range(2 * (rows // BATCH)):
        next(stream)
    seconds = time.perf_counter() - started
    return {
        "pairs_per_second": round(2 * rows / seconds),
        "first_epoch_with_k_means_seconds": round(first, 1),
        "peak_mb": round(resident_mb() - before),
        "a_full_matrix_would_be_mb": round(8 * rows**2 / 2**20),
    }


def semidiscrete(rows: int, clusters: int | None) -> dict[str, Any]:
    """The search, the k-means of the clusters left out."""
    before = resident_mb()
    data = clustered(rows)
    coupling = SemidiscreteOT(1.0, clusters=clusters)
    coupling.load_state_dict(
        {
            "x1": data.x1,
            "c": data.c,
            "phi": torch.zeros(rows, dtype=torch.float64),
            "errors": torch.zeros(2),
        }
    )
    stream = coupling.stream(data, batch_size=BATCH, generator=torch.Generator().manual_seed(0))
    next(stream)
    batches = max(1, min(PAIRS, 2 * 10**9 // rows) // BATCH)
    started = time.perf_counter()
    for _ in range(batches):
        next(stream)
    seconds = time.perf_counter() - started
    return {
        "microseconds_per_pair": round(1e6 * seconds / (batches * BATCH), 2),
        "peak_mb": round(resident_mb() - before),
        "a_full_matrix_would_be_mb": round(8 * rows**2 / 2**20),
    }


def measure(key: dict[str, Any]) -> dict[str, Any]:
    """The cell of a key, in its own process."""
    with multiprocessing.get_context("spawn").Pool(
        1, initializer=torch.set_num_threads, initargs=(1,)
    ) as pool:
        function = stratified if key["coupling"] == "stratified" else semidiscrete
        return pool.apply(function, (key["rows"], key["clusters"]))


def main() -> None:
    """Fill the table."""
    table = opened(
        "What does it cost to pair with the whole data set instead of a batch?",
        {"dim": DIM, "condition_dim": CONDITION_DIM, "batch": BATCH},
    )
    keys: list[dict[str, Any]] = [{"coupling": "stratified", "rows": 100_000, "clusters": 1024}]
    for rows in (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000):
        keys.append({"coupling": "semidiscrete", "rows": rows, "clusters": None})
        if rows > ROWS_PER_CLUSTER:
            few = rows // ROWS_PER_CLUSTER
            keys.append({"coupling": "semidiscrete", "rows": rows, "clusters": few})
    table.fill(keys, measure)


if __name__ == "__main__":
    main()
