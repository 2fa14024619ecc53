"""The findings as one HTML page that needs nothing else: figures inside, no network, no scripts."""

from __future__ import annotations

import base64
import importlib.metadata
import io
import platform
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import matplotlib as mpl
import matplotlib.pyplot as plt
import torch
from matplotlib.axes import Axes

import cotlearn
from cotlearn import plots
from cotlearn.files import write_text
from cotlearn.report.findings import NFE, Findings

PACKAGES = ("torch", "numpy", "scipy", "scikit-learn", "POT")


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
    path = Path(path)
    source = resources.files("cotlearn.report").joinpath("page.html").read_text("utf-8")
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    text = environment.from_string(source).render(
        **tables(findings),
        frontier_figure=_figure(findings, _frontier),
        score_figure=_figure(findings, _scores),
        command=command,
        model=None if model is None else Path(model).name,
    )
    write_text(path, text)
    return path


def tables(findings: Findings) -> dict[str, Any]:
    """All words and numbers of the page."""
    advice, rows = findings.advice, findings.rows
    free = advice.frontier["independent"]
    points = [
        {
            "name": p.name,
            "skew": f"{p.skew:.3f}",
            "flagged": "yes" if p.flagged else "no",
            "explained": "-" if p.linear_skew is None else f"{100 * p.linear_skew.explained:.1f} %",
            "variance": f"{p.one_step_variance:.3g}",
            "score": f"{p.one_step_score:.3f}",
            "gain": f"{100 * (1 - p.one_step_score / free.one_step_score):+.1f} %",
            "candidates": f"{p.candidates:.0f}",
            "chosen": p.name == advice.name,
        }
        for p in advice.frontier
    ]
    trials = [{"name": t.name, "scores": [f"{t.at(n):.3f}" for n in NFE]} for t in findings.trials]
    gains = []
    if len(findings.trials) > 1:
        for n in NFE:
            gain, error = findings.gain(n)
            gains.append(f"{gain:+.3f} ± {1.96 * error:.3f}")
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {
        "name": rows.data.name,
        "about": rows.about,
        "facts": {
            "rows to train on": len(findings.train),
            "rows held out": len(findings.test),
            "numbers in x1": findings.train.dim,
            "numbers in c": findings.train.condition_dim,
            "distinct conditions": len(torch.unique(findings.train.c, dim=0)),
            "groups that stay together": int(rows.group.max()) + 1,
        },
        "between": f"{100 * advice.spread.between_share:.0f}",
        "within": f"{100 - 100 * advice.spread.between_share:.0f}",
        "choice": advice.name,
        "reason": advice.reason,
        "verdict": findings.verdict(),
        "points": points,
        "nfe": NFE,
        "trials": trials,
        "gains": gains,
        "settings": findings.settings,
        "versions": {
            "cotlearn": getattr(cotlearn, "__version__", importlib.metadata.version("cotlearn")),
            "python": platform.python_version(),
            **versions,
        },
    }


def _figure(findings: Findings, draw: Any) -> str:
    """A PNG as text, drawn in the style of the course without changing the caller's."""
    with mpl.rc_context():
        plots.use_style()
        figure, ax = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
        try:
            draw(findings, ax)
            file = io.BytesIO()
            figure.savefig(file, format="png", dpi=130, facecolor="white")
        finally:
            plt.close(figure)
    return base64.b64encode(file.getvalue()).decode("ascii")


def _frontier(findings: Findings, ax: Axes) -> None:
    plots.frontier(findings.advice.frontier, ax=ax)


def _scores(findings: Findings, ax: Axes) -> None:
    scores = {t.coupling: [t.at(n) for n in NFE] for t in findings.trials}
    labels = {t.coupling: t.name for t in findings.trials}
    plots.error_against_nfe(
        NFE, scores, labels=labels, ax=ax, log=False, ylabel="energy score, held-out rows"
    )
