"""The checks of the exercises: the files of `notebooks/checks`, as modules of this package.

They lie beside the notebooks that ask; `cotlearn.course.checks.nb03` is `notebooks/checks/nb03.py`.
"""

from cotlearn.course.assets import course_folder

__path__ = [str(course_folder() / "notebooks" / "checks")]
