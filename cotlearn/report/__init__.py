"""A report on data of your own: which coupling, why, and a few-step model that was tried.

``read_data(path)`` opens an .npz with x1 and c, a LeRobot folder or a Diffusion Policy zarr;
``examine(rows)`` looks, recommends, trains and scores; ``write_page(findings, path)`` tells it.
"""

from cotlearn.report.findings import Trial, examine
from cotlearn.report.model import FewStepModel
from cotlearn.report.page import write_page
from cotlearn.report.sources import Rows, from_arrays, read_data

__all__ = ["FewStepModel", "Rows", "Trial", "examine", "from_arrays", "read_data", "write_page"]
