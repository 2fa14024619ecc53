"""Every figure of the course.

These functions only draw their arguments and compute nothing. They accept torch tensors or numpy
arrays and return the Axes, the array of Axes, or the animation. If a figure can be a panel of a
larger one, ``ax`` is that panel; by default a new figure is opened. ``style`` defines colours,
markers and labels.
"""

from cotlearn.plots._canvas import panels
from cotlearn.plots.arm import arm_paths, arm_paths_3d, arm_pose
from cotlearn.plots.charts import curves, error_against_nfe, histogram, score_against_nfe
from cotlearn.plots.fields import contours, net, outlines, velocity_field
from cotlearn.plots.images import image_grid, picture_grid
from cotlearn.plots.motion import animate, film, gif
from cotlearn.plots.points import (
    over_data,
    pair_lines,
    paired_source,
    scatter,
    source_given_condition,
    trajectories,
)
from cotlearn.plots.push_t import push_t_animation, push_t_chunks, push_t_episode
from cotlearn.plots.rows import bars, beside_published, differences, strata_heatmap
from cotlearn.plots.style import (
    COLORS,
    CONDITION_COLORS,
    LOOKS,
    PATH_COLOR,
    SOURCE_COLOR,
    label_of,
    style_of,
    use_style,
)
from cotlearn.plots.table import table
from cotlearn.plots.tradeoff import frontier

__all__ = [
    "COLORS",
    "CONDITION_COLORS",
    "LOOKS",
    "PATH_COLOR",
    "SOURCE_COLOR",
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
    "histogram",
    "image_grid",
    "label_of",
    "net",
    "outlines",
    "over_data",
    "pair_lines",
    "paired_source",
    "panels",
    "picture_grid",
    "push_t_animation",
    "push_t_chunks",
    "push_t_episode",
    "scatter",
    "score_against_nfe",
    "source_given_condition",
    "strata_heatmap",
    "style_of",
    "table",
    "trajectories",
    "use_style",
    "velocity_field",
]
