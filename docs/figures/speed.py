"""Draw docs/figures/speed.png from the stored benchmarks: what pairing costs.

python docs/figures/speed.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from PIL import Image
from scipy.stats import gmean

from cotlearn import plots
from cotlearn.results import read_table

HERE = Path(__file__).resolve().parent


def exact_pairing(ax: Axes) -> None:
    """Geometric means over dimensions, targets and weights, for each batch size."""
    table = read_table("assignment").set_index("rows").filter(like="milliseconds_")
    means = table.groupby("rows").agg(gmean)
    for name in ("scipy", "pot", "torchcfm", "cotlearn"):
        width = 2.5 if name == "cotlearn" else 1.2
        ax.loglog(means[f"milliseconds_{name}"], marker="o", label=name, lw=width)
    ax.set(xlabel="rows of the batch", ylabel="milliseconds", title="one exact pairing")
    ax.set_xticks(means.index, [str(size) for size in means.index])
    ax.minorticks_off()
    ax.legend()


def semidiscrete_search(ax: Axes) -> None:
    """Time for one pair against the rows that are searched."""
    cells = read_table("whole_data").query("coupling == 'semidiscrete'").set_index("rows")
    clustered = cells["clusters"].notna()
    for chosen, label in ((~clustered, "all rows"), (clustered, "clusters of 1,000 rows")):
        ax.loglog(cells.loc[chosen, "microseconds_per_pair"], marker="o", label=label)
    ax.set(xlabel="rows of the data", ylabel="microseconds", title="one semidiscrete pair")
    ax.legend()


def main() -> None:
    """Draw both panels."""
    plots.use_style()
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    exact_pairing(axes[0])
    semidiscrete_search(axes[1])
    path = HERE / "speed.png"
    figure.savefig(path, dpi=110)
    with Image.open(path) as picture:
        picture.convert("RGB").quantize(64).save(path, optimize=True)  # a third of the bytes


if __name__ == "__main__":
    main()
