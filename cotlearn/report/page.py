"""The findings as one HTML page that needs nothing else: figures inside, no network, no scripts."""

from __future__ import annotations

import base64
import importlib.metadata
import io
import platform
from collections.abc import Callable
from importlib import resources
from pathlib import Path

import jinja2
import matplotlib as mpl
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cotlearn import plots
from cotlearn.files import write_text
from cotlearn.report.findings import NFE, Findings

PACKAGES = ("cotlearn", "torch", "numpy", "scipy", "scikit-learn", "POT")


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
    source = resources.files("cotlearn.report").joinpath("page.html").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    advice, rows, train = findings.advice, findings.rows, findings.train
    text = environment.from_string(source).render(
        name=rows.data.name,
        about=rows.about,
        facts={
            "rows to train on": len(train),
            "rows held out": len(findings.test),
            "numbers in x1": train.dim,
            "numbers in c": train.condition_dim,
            "distinct conditions": len(torch.unique(train.c, dim=0)),
            "groups that stay together": int(rows.group.max()) + 1,
        },
        advice=advice,
        free=advice.frontier["independent"],
        nfe=NFE,
        trials=findings.trials,
        gains=[findings.gain(n) for n in NFE] if len(findings.trials) > 1 else [],
        verdict=findings.verdict(),
        frontier_figure=_figure(lambda ax: plots.frontier(advice.frontier, ax=ax)),
        score_figure=_figure(lambda ax: _scores(findings, ax)),
        command=command,
        model=None if model is None else Path(model).name,
        settings=findings.settings,
        versions={"python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in PACKAGES},
    )
    write_text(path, text)
    return Path(path)


def _figure(draw: Callable[[Axes], object]) -> str:
    """A PNG as text, drawn in the style of the course without changing the caller's."""
    with mpl.rc_context():
        plots.use_style()
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        draw(figure.subplots())
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=130, facecolor="white")
    return base64.b64encode(file.getvalue()).decode("ascii")


def _scores(findings: Findings, ax: Axes) -> None:
    scores = {t.coupling: [t.at(n) for n in NFE] for t in findings.trials}
    labels = {t.coupling: t.name for t in findings.trials}
    plots.error_against_nfe(
        NFE, scores, labels=labels, ax=ax, log=False, ylabel="energy score, held-out rows"
    )
