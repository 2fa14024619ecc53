"""The names of the compared couplings in plain words, as on the page."""

import re

from cotlearn.couplings import StratifiedOT
from cotlearn.report.findings import Findings

#: The pattern of a name, and what it means.
MEANINGS = {
    "independent": "noise and data are paired at random: ordinary flow matching.",
    "naive OT": "in each batch, the pairs with the smallest total distance, whatever c is.",
    r"COT x [\d.]+": "as naive OT, but noise gets a condition too, drawn at random, and a pair of "
    "different conditions costs more. The number is the weight: at 1 the conditions of random "
    "pairs cost twice as much as their distance, at 0.1 a tenth of that.",
    "COT per label": "as naive OT, among the rows of a batch that have the same label.",
    "stratified by label": "as COT per label, among all rows of the label and not of one batch.",
    r"stratified, \d+ rows": "strata of about so many rows with near conditions; in each, noise "
    "and data are paired with the smallest total distance.",
    r"residuals, \d+ rows": "strata of about so many rows with near conditions; in each, noise is "
    "paired with what a line through the conditions leaves of the data.",
}


def in_words(findings: Findings) -> dict[str, str]:
    """What the couplings of the report are; names of one kind stand together."""
    names = [point.name for point in findings.advice.frontier]
    found = {
        "; ".join(name for name in names if re.fullmatch(pattern, name)): meaning
        for pattern, meaning in MEANINGS.items()
    }
    return {kind: meaning for kind, meaning in found.items() if kind}


def strata(findings: Findings) -> str:
    """How the number of strata in the code fits the rows in the name; empty without strata."""
    coupling, number = findings.coupling, re.search(r"(\d+) rows", findings.chosen.name)
    if not isinstance(coupling, StratifiedOT) or coupling.clusters is None or number is None:
        return ""
    k, train, rows = coupling.clusters.clusters, len(findings.train), len(findings.rows.data)
    return (
        f"The {k} in KMeansCondition({k}) is the number of strata. The couplings were compared "
        f"with about {number[1]} rows in each: three quarters of the {train} training rows, "
        f"in {k} parts. A training on all {train} has about {train / k:.0f} in each, and the "
        f"lines above, which take all {rows} rows of your data, about {rows / k:.0f}."
    )


def what_to_do(findings: Findings) -> str:
    """One sentence after the headline."""
    if findings.advice.regression_wins:
        return "The lines below are only for a flow that you train all the same."
    if findings.chosen is findings.trials[0]:
        return "If your own loop has them, leave it; else take the lines below."
    return "Copy the lines below and put your network in."
