"""The tasks of the course by name; a new task is registered here."""

from cotlearn.robots.arm.definition import ARM_AVOID, ARM_RING
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.task import Task
from cotlearn.validation import check_choice

TASKS = {task.name: task for task in (PUSH_T, ARM_RING, ARM_AVOID)}


def find_task(name: str) -> Task:
    """Look up a task by name.

    Raises:
        ValueError: there is no task with this name.
    """
    return TASKS[check_choice(name, "task", tuple(TASKS))]
