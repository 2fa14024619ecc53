"""What makes notebooks a course: claims, checks of exercises, data by name, grades.

A notebook needs one line::

    from cotlearn.course import check, claim

`claim` asserts a sentence on every run. `check` judges an answer; an unchanged stub prints "not
attempted yet", so a notebook runs from top to bottom before any exercise is done. `progress()` says
what is done. The checks themselves are in `notebooks/checks/`, one file per notebook.
"""

from cotlearn.course.assets import find_data
from cotlearn.course.checking import check, passed, require
from cotlearn.course.claims import claim
from cotlearn.course.overview import progress

__all__ = ["check", "claim", "find_data", "passed", "progress", "require"]
