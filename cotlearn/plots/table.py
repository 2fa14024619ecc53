"""Tables: HTML in a notebook and on the site, aligned text elsewhere."""

import html
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cotlearn.plots.style import label_of


@dataclass(frozen=True, repr=False)
class Table:
    """The cells of a table as words.

    Attributes:
        head: the names of the columns.
        rows: one tuple of words for each row.
        best: (row, column) of the cells that are marked.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    best: frozenset[tuple[int, int]]

    def __repr__(self) -> str:
        marked = [
            [word + "*" * ((i, k) in self.best) for k, word in enumerate(row)]
            for i, row in enumerate(self.rows)
        ]
        lines = [self.head, *marked]
        wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [[line[0].ljust(wide[0]), *map(str.rjust, line[1:], wide[1:])] for line in lines]
        return "\n".join("  ".join(line).rstrip() for line in padded)

    def _repr_html_(self) -> str:
        def line(tag: str, words: Sequence[str], row: int = -1) -> str:
            escaped = map(html.escape, words)
            bold = (f"<b>{w}</b>" if (row, k) in self.best else w for k, w in enumerate(escaped))
            return "<tr>" + "".join(f"<{tag}>{word}</{tag}>" for word in bold) + "</tr>"

        body = "".join(line("td", row, i) for i, row in enumerate(self.rows))
        return f"<table><thead>{line('th', self.head)}</thead><tbody>{body}</tbody></table>"


def table(
    rows: Sequence[Mapping[str, Any]],
    *,
    low: Sequence[str] = (),
    high: Sequence[str] = (),
    digits: int = 3,
) -> Table:
    """Make a table of rows with the same columns, the best value of a column marked.

    Args:
        rows: column -> value, for each row, None if there is none; the columns are those of the
            first. A column "method" shows the labels of the methods.
        low: columns of numbers where the smallest is best.
        high: columns of numbers where the largest is best.
        digits: after the point, for floating-point numbers.
    """
    head = tuple(rows[0])
    best = set()
    for name in (*low, *high):
        choose = min if name in low else max
        top = choose(row[name] for row in rows if row[name] is not None)
        best |= {(i, head.index(name)) for i, row in enumerate(rows) if row[name] == top}
    words = (tuple(_word(name, row[name], digits) for name in head) for row in rows)
    return Table(head, tuple(words), frozenset(best))


def _word(name: str, value: Any, digits: int) -> str:
    if value is None:
        return ""
    if name == "method":
        return label_of(value)
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)
