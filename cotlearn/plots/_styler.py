"""A Styler that is also a table where there is no page: in a terminal and in a stored notebook."""

from html import unescape

from pandas.io.formats.style import Styler


class TextStyler(Styler):
    """pandas' Styler, whose `repr` is the aligned text of its cells instead of an address."""

    def __repr__(self) -> str:
        text = unescape(self.to_string(delimiter="\t"))
        lines = [line.split("\t") for line in text.splitlines()]
        wide = [max(map(len, column)) for column in zip(*lines, strict=True)]
        padded = [[line[0].ljust(wide[0]), *map(str.rjust, line[1:], wide[1:])] for line in lines]
        return "\n".join("  ".join(line).rstrip() for line in padded)
