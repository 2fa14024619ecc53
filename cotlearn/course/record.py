"""The learner's progress: one small file on this machine, which is never sent anywhere.

It is `.cotlearn-progress.json` in the root of the checkout, which also has the exercises.
"""

import contextlib
import datetime
import json
import os
import sys
from collections.abc import Iterable
from pathlib import Path

from cotlearn.course import assets
from cotlearn.files import write_text


def file() -> Path:
    """Returns the path of the file, which may not exist yet.

    Raises:
        ValueError: If there is no checkout.
    """
    return assets.course_folder() / ".cotlearn-progress.json"


def in_notebook() -> bool:
    """Tells whether a person is working in a notebook; False if it is executed by a program."""
    if os.environ.get("COTLEARN_PROGRESS") == "0" or "IPython" not in sys.modules:
        return False
    shell = sys.modules["IPython"].get_ipython()
    return shell is not None and "IPKernelApp" in shell.config


def read() -> dict[str, dict[str, str]]:
    """Returns {exercise: {"verdict": ..., "when": ...}}; empty if the file cannot be read."""
    try:
        stored = json.loads(file().read_text(encoding="utf-8"))["exercises"]
        return {name: {k: item[k] for k in ("verdict", "when")} for name, item in stored.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}


def remember(verdicts: dict[str, str]) -> None:
    """Adds verdicts to the file; "not attempted yet" does not replace an earlier verdict.

    If the file cannot be written, or there is no checkout, nothing happens.

    Args:
        verdicts: {exercise: verdict}.
    """
    now = datetime.datetime.now().isoformat(timespec="seconds")
    attempted = {name: v for name, v in verdicts.items() if v != "not attempted yet"}
    _write(read() | {name: {"verdict": v, "when": now} for name, v in attempted.items()})


def forget(names: Iterable[str]) -> None:
    """Removes verdicts from the file, as those of a notebook that starts over."""
    gone = set(names)
    _write({name: item for name, item in read().items() if name not in gone})


def _write(known: dict[str, dict[str, str]]) -> None:
    text = json.dumps({"exercises": known}, indent=1, sort_keys=True) + "\n"
    with contextlib.suppress(OSError, ValueError):
        write_text(file(), text)
