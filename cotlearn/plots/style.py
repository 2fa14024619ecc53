"""The look of the course: one colour, marker, line style and label for each method.

The source is dark, paths are faint, samples are coloured by their condition, and a coupling keeps
its look in every figure, so that curves can also be told apart in grey. Coupling colours are those
of Okabe and Ito (https://jfly.uni-koeln.de/color/), with two more from Paul Tol's palettes
(https://sronpersonalpages.nl/~pault/), as are the colours of conditions.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import to_hex, to_rgb
from numpy.typing import NDArray

COLORS: dict[str, str] = {
    "independent": "#0072B2",
    "minibatch_ot": "#D55E00",
    "conditional_ot": "#009E73",
    "adaptive": "#CC79A7",
    "stratified": "#56B4E9",
    "residual": "#117733",
    "centred": "#DDAA33",
    "semidiscrete": "#E69F00",
    "aligned": "#882255",
    "reflow": "#999999",
    "diffusion": "#332288",
    "behaviour_cloning": "#997700",
    "truth": "#000000",
}
MARKERS: dict[str, str] = {
    "independent": "o",
    "minibatch_ot": "s",
    "conditional_ot": "^",
    "adaptive": "D",
    "stratified": "v",
    "residual": "d",
    "centred": "H",
    "semidiscrete": "P",
    "aligned": "X",
    "reflow": "*",
    "diffusion": "h",
    "behaviour_cloning": "p",
    "truth": ".",
}
LINESTYLES: dict[str, Any] = {
    "independent": "--",
    "minibatch_ot": "-.",
    "conditional_ot": "-",
    "adaptive": (0, (5, 1)),
    "stratified": (0, (3, 1, 1, 1)),
    "residual": (0, (7, 1, 2, 1)),
    "centred": (0, (9, 1.5)),
    "semidiscrete": (0, (1, 1)),
    "aligned": (0, (3, 1, 1, 1, 1, 1)),
    "reflow": (0, (5, 4)),
    "diffusion": (0, (6, 1, 1, 1)),
    "behaviour_cloning": (0, (4, 2)),
    "truth": ":",
}
LABELS: dict[str, str] = {
    "independent": "independent",
    "minibatch_ot": "minibatch OT (naive)",
    "conditional_ot": "conditional OT (COT)",
    "adaptive": "adaptive COT",
    "stratified": "stratified COT",
    "residual": "stratified COT, residuals",
    "centred": "stratified COT, centred",
    "semidiscrete": "semidiscrete COT",
    "aligned": "model-aligned",
    "reflow": "reflow",
    "diffusion": "diffusion",
    "behaviour_cloning": "regression (BC)",
    "truth": "truth",
}
CONDITION_COLORS: tuple[str, ...] = (
    "#4477AA",
    "#EE6677",
    "#228833",
    "#CCBB44",
    "#66CCEE",
    "#AA3377",
    "#BBBBBB",
    "#DD7733",
    "#332288",
    "#117733",
)
CONDITION_MARKERS: tuple[str, ...] = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
CONDITION_MAP = "viridis"
SOURCE_COLOR = "#222222"
PATH_COLOR = "#8c8c8c"

# Names that are in none of the tables above take the next free look, and keep it.
SPARE_COLORS: tuple[str, ...] = ("#444444", "#6699CC", "#999933", "#AA4499", "#661100", "#44AA99")
SPARE_MARKERS: tuple[str, ...] = ("<", ">", "8", "H", "1", "2", "3")
SPARE_LINESTYLES: tuple[Any, ...] = ("-", (0, (7, 2)), (0, (7, 2, 1, 2)), (0, (2, 1)), (0, (1, 3)))
_SPARE_LOOKS: dict[str, int] = {}

_STYLE_FILE = Path(__file__).parent.with_name("course.mplstyle")


def use_style() -> None:
    """Apply the course's style file to every figure made from now on."""
    plt.style.use(_STYLE_FILE)


def style_of(name: str) -> dict[str, Any]:
    """Colour, marker and line style of a method, as keyword arguments for ``Axes.plot``.

    A name that the course does not know, say that of a reader's own coupling, takes the next of
    210 spare looks when it is first drawn, and keeps it for the rest of the session.
    """
    if name in COLORS:
        return {"color": COLORS[name], "marker": MARKERS[name], "linestyle": LINESTYLES[name]}
    k = _SPARE_LOOKS.setdefault(name, len(_SPARE_LOOKS))
    return {
        "color": SPARE_COLORS[k % len(SPARE_COLORS)],
        "marker": SPARE_MARKERS[k % len(SPARE_MARKERS)],
        "linestyle": SPARE_LINESTYLES[k % len(SPARE_LINESTYLES)],
    }


def label_of(name: str, labels: Mapping[str, str] | None = None) -> str:
    """The words for a coupling in a legend: those of ``labels``, the course's, or its name."""
    return (labels or {}).get(name, LABELS.get(name, name))


def readable(color: str) -> str:
    """A colour for small text on white: darkened until its contrast is 4.5 to 1 (WCAG 2)."""
    rgb = np.array(to_rgb(color))
    while True:
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        if 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) >= 4.5:
            return to_hex((rgb[0], rgb[1], rgb[2]))
        rgb = 0.95 * rgb


def condition_color(k: int) -> str:
    """The colour of class ``k``; the ten colours repeat."""
    return CONDITION_COLORS[k % len(CONDITION_COLORS)]


def condition_marker(k: int) -> str:
    """The marker of class ``k``; the ten markers repeat."""
    return CONDITION_MARKERS[k % len(CONDITION_MARKERS)]


def condition_colors(values: NDArray[Any] | None, n_classes: int, *, plain: str) -> Any:
    """One colour a row for what ``as_classes`` read, or ``plain`` where there is no condition.

    Values that are not classes are spread over the colour map from the smallest to the largest.
    """
    if values is None:
        return plain
    if n_classes:
        return [condition_color(int(k)) for k in values]
    low = values.min(initial=np.inf)
    span = max(values.max(initial=-np.inf) - low, 1e-12)
    return plt.get_cmap(CONDITION_MAP)((values - low) / span)
