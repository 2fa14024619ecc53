"""The findings as one self-contained HTML page, with figures inside and without scripts."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import torch
from matplotlib.figure import Figure
from torch import Tensor

from cotlearn import plots
from cotlearn.files import page, write_text
from cotlearn.report.findings import BATCH, NFE, Findings
from cotlearn.report.names import in_words, strata, what_to_do
from cotlearn.report.snippet import own_loop
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
    chart: dict[str, Any] = {
        "ylabel": "energy score, held-out rows",
        "log": False,
        "labels": labels,
    }
    text = page(
        "cotlearn.report",
        findings=findings,
        nfe=NFE,
        frontier_figure=_figure(plots.frontier, findings.advice.frontier),
        score_figure=_figure(plots.error_against_nfe, NFE, scores, **chart),
        sample_figure=_figure(_samples, findings, size=(6.4, 0.6 + 2.9 * len(findings.trials))),
        axes_in_words=_axes(findings)[0],
        own_loop=own_loop(
            findings.coupling,
            findings.train,
            findings.rows.code,
            name=findings.chosen.name,
            steps=findings.settings["steps"],
            batch=BATCH,
        ),
        names=in_words(findings),
        strata=strata(findings),
        what_to_do=what_to_do(findings),
        command=command,
        model=model and Path(model).name,
        in_python=model and repr(Path(model).name),
        versions=machine("cotlearn", "scikit-learn", "POT")["versions"],
    )
    write_text(path, text)
    return Path(path)


def _axes(findings: Findings) -> tuple[str, Callable[[Tensor], Tensor]]:
    """What the two axes of the picture are, and the map of held-out rows (n, d) to them (n, 2)."""
    train, c = findings.train, findings.test.c
    assert c is not None  # `Rows` have conditions
    if train.dim == 1:
        return "the first column of c and x1", lambda x: torch.hstack([c[:, :1], x])
    if train.dim == 2:
        return "the two columns of x1", lambda x: x
    centre = train.x1.mean(dim=0)
    axes = torch.linalg.svd(train.x1 - centre, full_matrices=False)[2][:2].T
    return "the first two principal axes of x1", lambda x: (x - centre) @ axes


def _samples(findings: Findings, *, ax: Figure) -> None:
    """Held-out rows in grey, and a row of panels of samples for each trial."""
    words, place = _axes(findings)
    data = place(findings.test.x1)
    shown = (NFE[0], NFE[-1])
    panels = ax.subplots(len(findings.trials), len(shown), sharex=True, sharey=True, squeeze=False)
    for trial, row in zip(findings.trials, panels, strict=True):
        for nfe, panel in zip(shown, row, strict=True):
            title = f"{trial.name}, {nfe} evaluation{'s' if nfe > 1 else ''}"
            drawn = place(trial.drawn[NFE.index(nfe)])
            plots.over_data(drawn, data, coupling=trial.coupling, title=title, ax=panel)
    ax.supxlabel(words, fontsize="small")


def _figure(
    draw: Callable[..., object],
    *data: object,
    size: tuple[float, float] | None = None,
    **options: Any,
) -> str:
    """A PNG as text, drawn in the style of the course without changing the caller's.

    With a size `draw` gets the whole figure as `ax`, else one panel.
    """
    with mpl.rc_context():
        plots.use_style()
        figure = Figure(figsize=size or (6.4, 4.2), layout="constrained")
        draw(*data, ax=figure if size else figure.subplots(), **options)
        file = io.BytesIO()
        figure.savefig(file, format="png", dpi=130, facecolor="white")
    return base64.b64encode(file.getvalue()).decode("ascii")
