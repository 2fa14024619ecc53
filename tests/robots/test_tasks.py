"""The tasks, by name, and what it costs to ask for one."""

import subprocess
import sys

import pytest

PHYSICS = ("pymunk", "mujoco", "matplotlib")
MODULES = ("cotlearn.robots.push_t.task", "cotlearn.robots.arm.task", "cotlearn.robots.registry")


@pytest.mark.parametrize("module", MODULES)
def test_a_task_is_defined_without_its_physics(module):
    code = f"import sys, {module}; print(*[n for n in {PHYSICS} if n in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


@pytest.mark.parametrize("module", ["cotlearn.plots", "cotlearn.report"])
def test_the_base_installation_draws_and_reports_without_simulators(module):
    without = "sys.modules.update(dict.fromkeys(('gymnasium', 'pymunk', 'mujoco')))"
    code = f"import sys; {without}; import {module}"
    subprocess.run([sys.executable, "-c", code], check=True)
