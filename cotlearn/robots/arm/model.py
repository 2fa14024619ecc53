"""MuJoCo's model of the arm and its pillars; MuJoCo is imported when it is needed."""

import functools
import importlib
import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from cotlearn.extras import how_to_install
from cotlearn.robots.arm.constants import GOAL, pillars
from cotlearn.robots.task import Array

_MJCF = Path(__file__).with_name("arm.xml").read_text(encoding="utf-8")


@functools.cache
def mujoco() -> Any:
    """Import and return the module mujoco.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
    """
    wanted = os.environ.get("MUJOCO_GL")
    try:
        return importlib.import_module("mujoco")
    except ModuleNotFoundError as error:
        hint = f"the arm needs MuJoCo; install it with: {how_to_install('course')}"
        raise ModuleNotFoundError(hint, name=error.name) from error
    except (ImportError, AttributeError, RuntimeError):
        # MUJOCO_GL names a missing OpenGL backend, which some versions import immediately
        if wanted is None:
            raise
        os.environ["MUJOCO_GL"] = "disable"
        try:
            return importlib.import_module("mujoco")
        finally:
            os.environ["MUJOCO_GL"] = wanted


def model_of(state: Array) -> Any:
    """The `MjModel` of the arm with the pillars and the goal of a state (columns,)."""
    root = ElementTree.fromstring(_MJCF)
    (world,) = root.iter("worldbody")
    add = functools.partial(ElementTree.SubElement, world, "geom", {"class": "scene"})
    for number, (x, y, radius, height) in enumerate(pillars(state).tolist(), start=1):
        ends = f"{x!r} {y!r} 0 {x!r} {y!r} {height - radius!r}"
        name = f"pillar{number}"
        add(name=name, type="capsule", material="pillar", size=repr(radius), fromto=ends)
    look = {"type": "sphere", "material": "goal", "contype": "0", "conaffinity": "0"}
    add(name="goal", size="0.025", pos=" ".join(map(repr, state[GOAL].tolist())), **look)
    return mujoco().MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
