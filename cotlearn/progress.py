"""The progress bar of the whole course."""

import os
import sys
from typing import Any

from tqdm import tqdm

SWITCH = "COTLEARN_PROGRESS"  #: set to 0 to switch bars off, to 1 to force them
LINE_EVERY = 60  #: seconds between two lines where a bar cannot be drawn
_LINE = "{desc}: {n_fmt} of {total_fmt}, {elapsed} so far, {remaining} left{postfix}\n"


def in_notebook() -> bool:
    """Whether this code runs in a notebook's kernel."""
    ipython = sys.modules.get("IPython")
    return hasattr(ipython and ipython.get_ipython(), "kernel")


def said_on() -> Any:
    """The stream for what only a person reads: a notebook shows stderr as if it were an error."""
    return sys.stdout if in_notebook() else sys.stderr


def watched() -> bool:
    """Whether somebody looks: in a terminal or a notebook, unless COTLEARN_PROGRESS decides."""
    switch = os.environ.get(SWITCH)
    seen = sys.stderr.isatty() or (in_notebook() and "CI" not in os.environ)
    return switch != "0" if switch else seen


def _size() -> dict[str, int]:
    """A size for a terminal that does not know its own, where tqdm would draw nothing."""
    try:
        unknown = 0 in os.get_terminal_size(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):  # no terminal, but a notebook or a test
        unknown = in_notebook()
    return {"ncols": 80, "nrows": 24} if unknown else {}


def progress_bar(*, total: int, initial: int = 0, what: str = "", show: bool | None = None) -> Any:
    """A tqdm progress bar in terminals and notebooks, and elsewhere a line a minute.

    In a notebook it is text, as in a terminal: a widget is gone when the file is opened again.

    Args:
        total: total number of steps.
        initial: steps that are already done.
        what: label in front of the bar.
        show: whether to show a bar. If None, the environment variable COTLEARN_PROGRESS decides
            (0: neither bar nor lines), and if that is not set, whether this is a terminal or a
            notebook.
    """
    nobody = not (os.environ.get(SWITCH) or in_notebook() or sys.stderr.isatty())
    lines = show is None and nobody
    show = watched() if show is None else show
    seldom: dict[str, Any] = {"delay": LINE_EVERY, "mininterval": LINE_EVERY, "miniters": 1}
    options = {**seldom, "bar_format": _LINE} if lines else {"leave": False, **_size()}
    options |= {"total": total, "initial": initial, "desc": what, "file": said_on()}
    return tqdm(disable=not (show or lines), **options)
