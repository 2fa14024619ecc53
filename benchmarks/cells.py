"""What benchmarks share: the table that each fills (`cotlearn.results.Table`), and a score."""

import argparse
import shlex
import sys
from pathlib import Path
from typing import Any

import torch

from cotlearn.metrics import ConditionalData, ConditionalSampler, conditional_squared_w2
from cotlearn.results import Table

RESULTS = Path(__file__).resolve().parents[1] / "data" / "results"
COMMAND = shlex.join(["python", f"benchmarks/{Path(sys.argv[0]).name}", *sys.argv[1:]])


def opened(
    question: str,
    protocol: dict[str, Any],
    *,
    parser: argparse.ArgumentParser | None = None,
    name: str = "",
    axis: str = "",
) -> Table:
    """The table of this benchmark, or the file of `--output`; torch gets one thread.

    Args:
        question: what it answers: the first line is kept.
        protocol: everything that all cells share.
        parser: with more options, which have been read already.
        name: of the file; that of the benchmark if empty.
        axis: what numbers within values are, see `Table`.
    """
    question = question.splitlines()[0]
    parser = parser or argparse.ArgumentParser(description=question)
    default = RESULTS / f"{name or Path(sys.argv[0]).stem}.csv"
    parser.add_argument("--output", type=Path, default=default)
    torch.set_num_threads(1)
    output = parser.parse_args().output
    return Table(output, question=question, command=COMMAND, protocol=protocol, axis=axis)


def beside(table: Table, name: str, question: str) -> Table:
    """A second table of a benchmark, in the same folder, with the same protocol."""
    path = table.path.with_name(f"{table.path.stem}_{name}.csv")
    return Table(path, question=question, command=COMMAND, protocol=table.about["protocol"])


def score(sample: ConditionalSampler, data: ConditionalData, seed: int) -> float:
    """Squared W2 for each condition, averaged, of 500 samples each, with noise of its own seed."""
    generator = torch.Generator().manual_seed(1000 + seed)
    return round(conditional_squared_w2(sample, data, n=500, generator=generator), 4)
