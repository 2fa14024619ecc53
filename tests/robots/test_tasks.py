"""The tasks, by name, and what it costs to ask for one."""

import subprocess
import sys

import gymnasium
import numpy as np
import pytest

from cotlearn.course.assets import find_data
from cotlearn.robots.registry import TASKS, find_task

PHYSICS = ("pymunk", "mujoco", "matplotlib")
MODULES = (
    "cotlearn.robots.push_t.constants",
    "cotlearn.robots.arm.constants",
    "cotlearn.robots.registry",
)


@pytest.mark.slow
def test_a_task_is_defined_without_its_physics():
    """All modules in one process: what one of them loads would be there in the end."""
    code = f"import sys, {', '.join(MODULES)}; print(*[n for n in {PHYSICS} if n in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


@pytest.mark.slow
def test_the_base_installation_draws_and_reports_without_simulators():
    without = "sys.modules.update(dict.fromkeys(('gymnasium', 'pymunk', 'mujoco')))"
    code = f"import sys; {without}; import cotlearn.plots, cotlearn.report"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("task", TASKS.values(), ids=TASKS)
def test_a_registered_task_is_complete(task):
    """Environment, simulations, frames and demonstrations belong together."""
    assert find_task(task.name) is task
    state, _ = gymnasium.make(task.environment).reset(seed=3)
    states = task.vector_sim([2, 3]).states
    assert states.shape == (2, len(task.state)) == (2, len(task.state_units))
    assert state[:4] == pytest.approx(states[1, :4])
    assert ((states >= task.state_limits[0]) & (states <= task.state_limits[1])).all()
    if task.demonstrations:
        assert find_data(task.demonstrations).is_file()
    history = np.repeat(states[:, None], 2, axis=1)
    actions = np.random.default_rng(0).uniform(*task.action_limits, (2, 5, len(task.action)))
    for frame in task.frames.values():
        assert frame.observe(history).shape == (2, 2, frame.features)
        there = frame.to_frame(actions, history)
        assert np.allclose(frame.from_frame(there, history), actions)


def test_an_unknown_task_is_refused():
    with pytest.raises(ValueError, match=f"task must be one of {', '.join(TASKS)}"):
        find_task("juggling")
