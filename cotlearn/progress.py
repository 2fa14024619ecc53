"""The progress bar of the whole course."""

import os
import sys
from typing import Any

from tqdm.auto import tqdm

SWITCH = "COTLEARN_PROGRESS"  #: set to 0 to switch bars off, to 1 to force them
LINE_EVERY = 60  #: seconds between two lines where a bar cannot be drawn
_LINE = "{desc}: {n_fmt} of {total_fmt}, {elapsed} so far, {remaining} left{postfix}\n"


def watched() -> bool:
    """Whether somebody looks: in a terminal or a notebook, unless COTLEARN_PROGRESS decides."""
    ipython, switch = sys.modules.get("IPython"), os.environ.get(SWITCH)
    kernel = hasattr(ipython and ipython.get_ipython(), "kernel")  # in a notebook
    seen = sys.stderr.isatty() or (kernel and "CI" not in os.environ)
    return switch != "0" if switch else seen


def _size() -> dict[str, int]:
    """A size for a terminal that does not know its own, where tqdm would draw nothing."""
    try:
        unknown = 0 in os.get_terminal_size(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):  # no terminal, but a notebook or a test
        unknown = False
    return {"ncols": 80, "nrows": 24} if unknown else {}


def progress_bar(*, total: int, initial: int = 0, what: str = "", show: bool | None = None) -> Any:
    """A tqdm progress bar in terminals and notebooks, and elsewhere a line a minute.

    Args:
        total: total number of steps.
        initial: steps that are already done.
        what: label in front of the bar.
        show: whether to show a bar. If None, the environment variable COTLEARN_PROGRESS decides
            (0: neither bar nor lines), and if that is not set, whether this is a terminal or a
            notebook.
    """
    ipython, switch = sys.modules.get("IPython"), os.environ.get(SWITCH)
    kernel = hasattr(ipython and ipython.get_ipython(), "kernel")  # in a notebook
    lines = show is None and not switch and not kernel and not sys.stderr.isatty()
    show = watched() if show is None else show
    seldom: dict[str, Any] = {"delay": LINE_EVERY, "mininterval": LINE_EVERY, "miniters": 1}
    options = {**seldom, "bar_format": _LINE} if lines else {"leave": False, **_size()}
    return tqdm(total=total, initial=initial, desc=what, disable=not (show or lines), **options)
