"""The progress bar of the whole course."""

import os
import sys
from typing import Any

from tqdm.auto import tqdm

SWITCH = "COTLEARN_PROGRESS"  #: set to 0 to switch bars off, to 1 to force them


def progress_bar(*, total: int, initial: int = 0, what: str = "", show: bool | None = None) -> Any:
    """A tqdm progress bar, shown in terminals and notebooks.

    Args:
        total: total number of steps.
        initial: steps that are already done.
        what: label in front of the bar.
        show: whether to show the bar; if None, the environment variable COTLEARN_PROGRESS decides
            (0 hides it), and if that is not set, whether this is a terminal or a notebook.
    """
    if show is None:
        switch = os.environ.get(SWITCH)
        show = switch != "0" if switch else sys.stderr.isatty() or _in_notebook()
    return tqdm(total=total, initial=initial, desc=what, disable=not show, leave=False)


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return hasattr(shell, "kernel") and "CI" not in os.environ
