"""The findings as one self-contained HTML page, with figures inside and without scripts."""

import base64
import io
from collections.abc import Callable
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from cotlearn import plots
from cotlearn.files import page, write_text
from cotlearn.report.findings import NFE, Findings
from cotlearn.results import machine


def write_page(
    findings: Findings, path: str | Path, *, command: str = "", model: str | Path | None = None
) -> Path:
    """Write the page, atomically.

    Args:
        findings: of `examine`.
        path: the file to make.
        command: how it was made, to be printed.
        model: where the model was saved, to be mentioned.

    Returns:
        The path.
    """
    scores = {t.coupling: [t.at(n) for n in NFE] for t in findings.trials}
    labels = {t.coupling: t.name for t in findings.trials}
    chart = {"ylabel": "energy score, held-out rows", "log": False, "labels": labels}
    text = page(
        "cotlearn.report",
        findings=findings,
        nfe=NFE,
        frontier_figure=_figure(plots.frontier, findings.advice.frontier),
        score_figure=_figure(plots.error_against_nfe, NFE, scores, **chart),
        command=command,
        model=model and Path(model).name,
        in_python=model and repr(Path(model).name),
        versions=machine("cotlearn", "scikit-learn", "POT")["versions"],
    )
    write_text(path, text)
    return Path(path)


def _figure(draw: Callable[..., object], *data: object, **options: object) -> str:
    """A PNG as text, drawn in the style of the course without changing the caller's."""
    with mpl.rc_context():
        plots.use_style()
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        draw(*data, ax=figure.subplots(), **options)
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=130, facecolor="white")
    return base64.b64encode(file.getvalue()).decode("ascii")
