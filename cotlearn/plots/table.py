"""Tables of results: a pandas Styler that marks the best of each column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from cotlearn.plots.style import label_of

if TYPE_CHECKING:
    from pandas import DataFrame
    from pandas.io.formats.style import Styler


def table(
    rows: DataFrame | Sequence[Mapping[str, Any]],
    *,
    low: Sequence[str] = (),
    high: Sequence[str] = (),
    level: DataFrame | Mapping[str, Sequence[bool]] | None = None,
    digits: int = 3,
) -> Styler:
    """Show rows with the same columns, the best value of a column in bold.

    Args:
        rows: a data frame, or column -> value for each row; a missing value is an empty cell. A
            column "method" shows the labels of the methods.
        low: columns of numbers where the smallest is best.
        high: columns of numbers where the largest is best.
        level: column -> for each row whether its value cannot be told from the best one; these are
            underlined.
        digits: after the point, for floating-point numbers.
    """
    from pandas import DataFrame

    from cotlearn.plots._styler import TextStyler

    # a count stays one where another row has none
    frame = DataFrame(rows, dtype=object).reset_index(drop=True)
    if "method" in frame:
        frame["method"] = frame["method"].map(label_of)
    style = TextStyler(frame).hide(axis="index").format(precision=digits, na_rep="", escape="html")
    for names, best in ((low, "min"), (high, "max")):
        style = style.apply(_bold, best=best, digits=digits, subset=list(names))
    marks = {} if level is None else {name: list(map(bool, of)) for name, of in level.items()}
    for name, rows_level in marks.items():
        style = style.apply(_underlined, rows_level=rows_level, subset=[name])
    return style.set_uuid(_name(f"{style}{low}{high}{marks or ''}"))


def _name(text: str) -> str:
    """The same for the same text: a notebook that runs again stores the same page."""
    return sha256(text.encode()).hexdigest()[:5]


def _bold(column: Any, *, best: str, digits: int) -> list[str]:
    """The style of each cell: cells that read the same as the best are all bold."""
    shown = column.astype(float).round(digits)
    return ["font-weight: bold" if same else "" for same in shown == getattr(shown, best)()]


def _underlined(column: Any, *, rows_level: list[bool]) -> list[str]:
    """The style of each cell of a column."""
    return ["text-decoration: underline" if one else "" for one in rows_level]
