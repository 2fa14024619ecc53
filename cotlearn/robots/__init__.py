"""Robots: tasks and demonstrations on the ground floor, policies and rollouts above the flows.

Importing this package registers the environments with gymnasium::

    import gymnasium
    import cotlearn.robots

    env = gymnasium.make("cotlearn/PushT-v0")
"""

import gymnasium

from cotlearn.robots.push_t.task import MAX_STEPS

gymnasium.register(
    id="cotlearn/PushT-v0",
    entry_point="cotlearn.robots.push_t.environment:PushT",
    max_episode_steps=MAX_STEPS,
)
