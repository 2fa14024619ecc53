"""The look of the course: one label, colour, marker and line style for each method.

The source is dark, paths are faint, samples are coloured by their condition, and a coupling keeps
its look in every figure, so that curves can also be told apart in grey. Coupling colours are those
of Okabe and Ito (https://jfly.uni-koeln.de/color/), with some more from Paul Tol's palettes
(https://sronpersonalpages.nl/~pault/), as are the colours of conditions.
"""

from collections.abc import Mapping
from itertools import cycle
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import Normalize, to_hex, to_rgb

from cotlearn.plots._canvas import Numbers, read_condition


class Look(NamedTuple):
    """The look of a method: its legend label, colour, marker and line style."""

    label: str
    color: str
    marker: str
    linestyle: Any


LOOKS = {
    "independent": Look("independent", "#0072B2", "o", "--"),
    "minibatch_ot": Look("naive OT", "#D55E00", "s", "-."),
    "conditional_ot": Look("conditional OT (COT)", "#009E73", "^", "-"),
    "adaptive": Look("adaptive COT", "#CC79A7", "D", (0, (5, 1))),
    "stratified": Look("stratified pairs", "#56B4E9", "v", (0, (3, 1, 1, 1))),
    "residual": Look("residual pairs", "#117733", "d", (0, (7, 1, 2, 1))),
    "centred": Look("centred pairs", "#DDAA33", "H", (0, (9, 1.5))),
    "semidiscrete": Look("semidiscrete COT", "#E69F00", "P", (0, (1, 1))),
    "aligned": Look("model-aligned", "#882255", "X", (0, (3, 1, 1, 1, 1, 1))),
    "reflow": Look("reflow", "#999999", "*", (0, (5, 4))),
    "reflow_inverted": Look("reflow on real data", "#661100", "<", (0, (5, 2, 1, 2))),
    "adaptive_weights": Look("flow, adaptive weights", "#CC6677", "+", (0, (2, 1))),
    "adaptive_weights_residual": Look("adaptive, residual pairs", "#882222", "x", (0, (7, 2))),
    "mean_flow": Look("MeanFlow", "#44AA99", ">", (0, (4, 1))),
    "mean_flow_residual": Look("MeanFlow, residual pairs", "#999933", "1", (0, (8, 2))),
    "mean_flow_data": Look("MeanFlow, chunk", "#44BB66", "$\\oplus$", (0, (4, 1, 2, 1))),
    "mean_flow_data_residual": Look("MeanFlow, chunk, residual pairs", "#225533", "_", (0, (2, 3))),
    "shortcut": Look("shortcut model", "#6699CC", "2", (0, (4, 1, 1, 1))),
    "shortcut_residual": Look("shortcut model, residual pairs", "#225588", "4", (0, (1, 3))),
    "drifting": Look("drifting", "#7766AA", "$\\diamond$", (0, (6, 2, 2, 2))),
    "two_passes": Look("two passes (MIP)", "#444444", "3", (0, (2, 2))),
    "diffusion": Look("diffusion", "#332288", "h", (0, (6, 1, 1, 1))),
    "diffusion_residual": Look("diffusion, residual pairs", "#AA4499", "8", (0, (6, 2))),
    "behaviour_cloning": Look("regression (BC)", "#997700", "p", (0, (4, 2))),
    "truth": Look("truth", "#000000", ".", ":"),
}
COLORS = {name: look.color for name, look in LOOKS.items()}
CONDITION_COLORS = (
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
CONDITION_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*")
CONDITION_MAP = "viridis"
SOURCE_COLOR = "#222222"
PATH_COLOR = "#8c8c8c"
FLOOR: dict[str, Any] = {"color": COLORS["truth"], "linestyle": ":", "linewidth": 1.3}

# Names that are not in the table take the next free look, and keep it.
_SPARE_COLORS = ("#555577", "#77AADD", "#BB5566", "#AA7744", "#225555", "#8877AA")
_SPARE_MARKERS = ("4", "+", "x", "|", "_", "$a$", "$b$")
_SPARE_LINES = ("-", (0, (7, 2)), (0, (7, 2, 1, 2)), (0, (2, 1)), (0, (1, 3)))
_SPARE = zip(cycle(_SPARE_COLORS), cycle(_SPARE_MARKERS), cycle(_SPARE_LINES), strict=True)
_SIGNS: dict[str, Any] = {name: look[1:] for name, look in LOOKS.items()}


def use_style() -> None:
    """Apply the course's style file to every figure made from now on."""
    plt.style.use("cotlearn.course")


def style_of(name: str) -> dict[str, Any]:
    """Colour, marker and line style of a method, as keyword arguments for ``Axes.plot``.

    A name that the course does not know, say that of a reader's own coupling, takes the next of
    210 spare looks when it is first drawn, and keeps it for the rest of the session.
    """
    if name not in _SIGNS:
        _SIGNS[name] = next(_SPARE)
    return dict(zip(("color", "marker", "linestyle"), _SIGNS[name], strict=True))


def label_of(name: str, labels: Mapping[str, str] | None = None) -> str:
    """The legend label of a coupling: from ``labels``, the course's own, or its name."""
    if labels and name in labels:
        return labels[name]
    return LOOKS[name].label if name in LOOKS else name


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


def condition_colors(c: Numbers, rows: int, *, plain: str = COLORS["independent"]) -> Any:
    """One colour for each row of a condition, or ``plain`` without one.

    Values that are not classes are spread over the colour map from the smallest to the largest.
    """
    values, n_classes = read_condition(c, rows)
    if values is None:
        return plain
    if n_classes:
        return np.array([condition_color(k) for k in values])
    return plt.get_cmap(CONDITION_MAP)(Normalize()(values))
