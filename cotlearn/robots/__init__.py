"""Robots as a source: tasks, experts, and the episodes that they leave.

Importing this package registers the environments with gymnasium::

    import gymnasium
    import cotlearn.robots

    env = gymnasium.make("cotlearn/PushT-v0")  # or "cotlearn/ArmRing-v0", "cotlearn/ArmAvoid-v0"
"""

import gymnasium

from cotlearn.robots.arm import task as _arm
from cotlearn.robots.push_t.task import MAX_STEPS

gymnasium.register(
    id="cotlearn/PushT-v0",
    entry_point="cotlearn.robots.push_t.environment:PushT",
    max_episode_steps=MAX_STEPS,
)

for _kind in _arm.KINDS:
    gymnasium.register(
        id=f"cotlearn/Arm{_kind.title()}-v0",
        entry_point="cotlearn.robots.arm.environment:Arm",
        max_episode_steps=_arm.MAX_STEPS,
        kwargs={"kind": _kind},
    )
