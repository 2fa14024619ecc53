"""Self-checks for the exercises of the course.

In a notebook::

    from cotlearn.homework import check

    check(interpolate, "01.interpolate")

An unchanged stub prints "not attempted yet", so a notebook runs from top to bottom before any
exercise is done. The checks themselves are in `cotlearn/homework/checks/`, one file per notebook.
"""

from cotlearn.homework.registry import NotYet, Verdict, check, exercise, exercises, passed, require

__all__ = ["NotYet", "Verdict", "check", "exercise", "exercises", "passed", "require"]
