"""The checks of the exercises, one file per notebook: `nb00.py` for notebook 00, and so on.

`cotlearn.course.checks` finds them here.
"""
