"""The tasks of the course, by name: a new task needs its line here, and is known everywhere."""

from cotlearn.robots.arm.definition import ARM_AVOID, ARM_RING
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.task import Task
from cotlearn.validation import check_choice

TASKS = {task.name: task for task in (PUSH_T, ARM_RING, ARM_AVOID)}


def find_task(name: str) -> Task:
    """The task of this name.

    Raises:
        ValueError: there is none.
    """
    return TASKS[check_choice(name, "task", tuple(TASKS))]
