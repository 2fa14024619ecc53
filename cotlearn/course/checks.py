"""The checks of the exercises: the files of `notebooks/checks`, as modules of this package.

They lie beside the notebooks that ask; `cotlearn.course.checks.nb03` is `notebooks/checks/nb03.py`.
"""

from pathlib import Path

from cotlearn.course.assets import checkout, course_folder

_root = checkout()
__path__ = [str(_root / "notebooks" / "checks")] if _root else []


def folder() -> Path:
    """Returns `notebooks/checks`, and from now on imports find its files.

    An installed package looks for them when they are asked for: a hosted notebook enters the
    checkout after it has imported this.

    Raises:
        ValueError: If there is no checkout.
    """
    found = course_folder() / "notebooks" / "checks"
    __path__[:] = [str(found)]
    return found
