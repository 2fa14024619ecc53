"""Every figure of the course.

The functions here draw and compute nothing: what they are given is what is seen. They accept torch
tensors or numpy arrays, take ``ax=None`` (a new figure) and return the Axes, the array of Axes, or
the animation. ``style`` says what everything looks like.
"""

from cotlearn.plots._canvas import PANEL_SIZE, panels
from cotlearn.plots.arm import arm_paths, arm_paths_3d, arm_pose
from cotlearn.plots.distributions import bars, histogram
from cotlearn.plots.images import image_grid, picture_grid
from cotlearn.plots.lines import curves, error_against_nfe, training_curves
from cotlearn.plots.motion import Gif, animate, film, gif, gif_bytes
from cotlearn.plots.pairs import pair_lines, paired_source, source_given_condition
from cotlearn.plots.paths import trajectories, velocity_field
from cotlearn.plots.points import scatter
from cotlearn.plots.policies import (
    differences,
    score_against_latency,
    score_against_nfe,
    strata_heatmap,
)
from cotlearn.plots.potentials import contours, net, outlines
from cotlearn.plots.push_t import (
    push_t_animation,
    push_t_chunks,
    push_t_episode,
    push_t_state,
)
from cotlearn.plots.results import beside_published
from cotlearn.plots.style import (
    COLORS,
    CONDITION_COLORS,
    CONDITION_MAP,
    CONDITION_MARKERS,
    LABELS,
    LINESTYLES,
    MARKERS,
    PATH_COLOR,
    SOURCE_COLOR,
    label_of,
    style_of,
    use_style,
)
from cotlearn.plots.tradeoff import frontier

__all__ = [
    "COLORS",
    "CONDITION_COLORS",
    "CONDITION_MAP",
    "CONDITION_MARKERS",
    "LABELS",
    "LINESTYLES",
    "MARKERS",
    "PANEL_SIZE",
    "PATH_COLOR",
    "SOURCE_COLOR",
    "Gif",
    "animate",
    "arm_paths",
    "arm_paths_3d",
    "arm_pose",
    "bars",
    "beside_published",
    "contours",
    "curves",
    "differences",
    "error_against_nfe",
    "film",
    "frontier",
    "gif",
    "gif_bytes",
    "histogram",
    "image_grid",
    "label_of",
    "net",
    "outlines",
    "pair_lines",
    "paired_source",
    "panels",
    "picture_grid",
    "push_t_animation",
    "push_t_chunks",
    "push_t_episode",
    "push_t_state",
    "scatter",
    "score_against_latency",
    "score_against_nfe",
    "source_given_condition",
    "strata_heatmap",
    "style_of",
    "training_curves",
    "trajectories",
    "use_style",
    "velocity_field",
]
