"""Draw docs/figures/speed.png from the stored benchmarks: what pairing costs.

python docs/figures/speed.py
"""

import json
import statistics
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from cotlearn import plots
from cotlearn.assets import find_data

HERE = Path(__file__).resolve().parent


def stored(name: str) -> list[dict[str, Any]]:
    """The cells of a stored table."""
    text = find_data(f"results/{name}.json").read_text(encoding="utf-8")
    return list(json.loads(text)["cells"])


def exact_pairing(ax: Axes) -> None:
    """Geometric means over dimensions, targets and weights, for each batch size."""
    cells = stored("assignment")
    sizes = sorted({cell["key"]["rows"] for cell in cells})
    for name in ("scipy", "pot", "torchcfm", "cotlearn"):
        means = [
            statistics.geometric_mean(
                c["milliseconds"][name] for c in cells if c["key"]["rows"] == size
            )
            for size in sizes
        ]
        ax.loglog(sizes, means, marker="o", label=name, lw=2.5 if name == "cotlearn" else 1.2)
    ax.set(xlabel="rows of the batch", ylabel="milliseconds", title="one exact pairing")
    ax.set_xticks(sizes, [str(size) for size in sizes])
    ax.minorticks_off()
    ax.legend()


def semidiscrete_search(ax: Axes) -> None:
    """Time for one pair against the rows that are searched."""
    cells = [c for c in stored("whole_data") if c["key"]["coupling"] == "semidiscrete"]
    for clustered, label in ((False, "all rows"), (True, "clusters of 1,000 rows")):
        chosen = [c for c in cells if (c["key"]["clusters"] is not None) == clustered]
        rows = [c["key"]["rows"] for c in chosen]
        ax.loglog(rows, [c["microseconds_per_pair"] for c in chosen], marker="o", label=label)
    ax.set(xlabel="rows of the data", ylabel="microseconds", title="one semidiscrete pair")
    ax.legend()


def main() -> None:
    """Draw both panels."""
    plots.use_style()
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    exact_pairing(axes[0])
    semidiscrete_search(axes[1])
    figure.savefig(HERE / "speed.png", dpi=110)


if __name__ == "__main__":
    main()
