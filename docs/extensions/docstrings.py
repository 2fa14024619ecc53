"""Reads the docstrings of the house as reStructuredText.

They write formulas as |x0 - x1|^2 and lists without an empty line before them; both mean something
else in reStructuredText. In a line with a formula indices and powers are set as such.
"""

import re

from sphinx.application import Sphinx

CODE = re.compile(r"(``.+?``|`[^`]+`)")
SPECIAL = re.compile(r"([|*\\]|(?<=\w)_(?!\w))")
#: What makes a line one with a formula: a power, or a sum or difference of noise and data.
FORMULA = re.compile(r"\^|\bx[01] [-+] |[-+] (?:\w )?x[01]\b")
INDEX = re.compile(r"\b([A-Za-z]+?)([01]?)(?:\\?_(\w|\{[^}]*\})|(?<=[A-Za-z][01]))(?![\w:])")
POWER = re.compile(r"\^(\w+|\*|\\\*|\{[^}]*\}|\([^)]*\))")
ITEM = re.compile(r"\s*- ")


def escape(text: str) -> str:
    r"""Return a line in which |, *, \ and a last underscore stand for themselves.

    Code between backticks stays as it is.
    """
    parts = CODE.split(text)
    return "".join(p if CODE.fullmatch(p) else typeset(SPECIAL.sub(r"\\\1", p)) for p in parts)


def typeset(text: str) -> str:
    """Return a line without code in which x0, x_t and x^2 have their index or power in place."""
    if not FORMULA.search(text):
        return text
    text = INDEX.sub(lambda m: rf"{m[1]}\ :sub:`{','.join(filter(None, m.groups()[1:]))}`\ ", text)
    text = re.sub(r":sub:`(.*?)\{(.*?)\}`", r":sub:`\1\2`", text)
    return POWER.sub(lambda m: rf"\ :sup:`{m[1].strip('{}')}`\ ", text)


def indentation(line: str) -> int:
    """Return the number of spaces before the text of a line."""
    return len(line) - len(line.lstrip())


def prepare(lines: list[str]) -> list[str]:
    """Return the lines of a docstring with formulas escaped and empty lines around lists.

    Indented blocks after `::` stay as they are.
    """
    result: list[str] = []
    block: int | None = None  # indentation of the line that ended in ::, while its block lasts
    item: int | None = None  # indentation of the last item, while its list lasts
    for line in lines:
        if not line.strip():
            result.append(line)
            item = None
            continue
        if block is not None and indentation(line) <= block:
            block = None
        if block is not None:
            result.append(line)
            continue
        begins, goes_on = bool(ITEM.match(line)), item is not None and indentation(line) > item
        if (begins and item is None) or (item is not None and not begins and not goes_on):
            result.append("")
        item = indentation(line) if begins else item if goes_on else None
        block = indentation(line) if line.rstrip().endswith("::") else None
        result.append(escape(line))
    return result


def process(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Change the lines of one docstring in place."""
    # napoleon takes what stands before a colon in an attribute's first line for its type
    first = [""] if what in {"attribute", "data", "property"} else []
    lines[:] = first + prepare(lines)


def escape_types(
    app: Sphinx, what: str, name: str, thing: object, options: object, lines: list[str]
) -> None:
    """Escape names like bool_ in the types that napoleon has written."""
    lines[:] = [escape(line) if line.startswith(":vartype") else line for line in lines]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the handlers, one before napoleon's and one after it."""
    app.connect("autodoc-process-docstring", process, priority=100)
    app.connect("autodoc-process-docstring", escape_types, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
