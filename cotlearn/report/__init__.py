"""A report on your own data: a recommended coupling, the reason, and a trained few-step model.

``read_data(path)`` reads an .npz with x1 and c, a LeRobot folder or a Diffusion Policy zarr;
``examine(rows)`` recommends a coupling, trains and scores it; ``write_page(findings, path)`` writes
the report.
"""

from cotlearn.report.findings import Trial, examine
from cotlearn.report.model import FewStepModel
from cotlearn.report.page import write_page
from cotlearn.report.sources import Rows, from_arrays, read_data

__all__ = ["FewStepModel", "Rows", "Trial", "examine", "from_arrays", "read_data", "write_page"]
