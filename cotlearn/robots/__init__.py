"""Robots as a source of data: tasks, experts and the episodes that experts record.

Importing this package registers the environments with gymnasium::

    import gymnasium
    import cotlearn.robots

    env = gymnasium.make("cotlearn/PushT-v0")  # or "cotlearn/ArmRing-v0", "cotlearn/ArmAvoid-v0"
"""

from importlib.util import find_spec

from cotlearn.robots.registry import TASKS

if find_spec("gymnasium"):  # the base installation reads and draws episodes without it
    import gymnasium

    for _task in TASKS.values():
        gymnasium.register(
            id=_task.environment,
            entry_point=_task.entry_point,
            max_episode_steps=_task.max_steps,
            kwargs=dict(_task.environment_options),
        )
