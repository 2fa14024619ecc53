"""MuJoCo's model of the arm in a world with pillars. MuJoCo is imported when it is needed."""

from __future__ import annotations

import functools
import importlib
import os
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from cotlearn.robots.arm import menagerie
from cotlearn.robots.arm.task import GOAL, pillars

OLDEST, TOO_NEW = (3, 3), (5, 0)  #: versions of MuJoCo: from the first on, and below the second
_NO_OPENGL = "disable"
_MJCF = Path(__file__).with_name("arm.xml").read_text(encoding="utf-8")


@functools.cache
def mujoco() -> Any:
    """The module mujoco.

    Raises:
        ModuleNotFoundError: it is not installed.
        ImportError: its version is not one that the arm works with.
    """
    try:
        module = _imported()
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "the arm needs MuJoCo; install it with: pip install 'cotlearn[course]'",
            name=error.name,
        ) from error
    version = tuple(int(part) for part in re.findall(r"\d+", module.__version__)[:2])
    if not OLDEST <= version < TOO_NEW:
        raise ImportError(
            f"the arm needs MuJoCo {'.'.join(map(str, OLDEST))} or newer, below "
            f"{'.'.join(map(str, TOO_NEW))}, but {module.__version__} is installed; "
            "pip install 'cotlearn[course]' brings one that fits"
        )
    return module


def _imported() -> Any:
    try:
        return importlib.import_module("mujoco")
    except (ImportError, AttributeError, RuntimeError) as error:
        # the OpenGL that MUJOCO_GL asks for is not there, and some versions import it at once
        wanted = os.environ.get("MUJOCO_GL")
        if isinstance(error, ModuleNotFoundError) or wanted in (None, _NO_OPENGL):
            raise
        os.environ["MUJOCO_GL"] = _NO_OPENGL
        try:
            return importlib.import_module("mujoco")
        finally:
            os.environ["MUJOCO_GL"] = wanted


def scene(state: NDArray[np.float64], *, model: str = "capsules") -> ElementTree.Element:
    """The MJCF of the arm with the pillars and the goal of a state (columns,).

    Args:
        state: see `task.columns`.
        model: "capsules", or "menagerie" for the looks of the real arm.
    """
    root = ElementTree.fromstring(_MJCF)
    if model == "menagerie":
        menagerie.dress(root, menagerie.find())
    (world,) = root.iter("worldbody")
    for number, (x, y, radius, height) in enumerate(pillars(state).tolist(), start=1):
        ElementTree.SubElement(
            world,
            "geom",
            {"class": "scene", "type": "capsule", "material": "pillar"},
            name=f"pillar{number}",
            size=repr(radius),
            fromto=f"{x!r} {y!r} 0 {x!r} {y!r} {height - radius!r}",
        )
    ElementTree.SubElement(
        world,
        "geom",
        {"class": "scene", "type": "sphere", "material": "goal"},
        name="goal",
        size="0.025",
        pos=" ".join(repr(value) for value in state[GOAL].tolist()),
        contype="0",
        conaffinity="0",
    )
    return root


def compiled(root: ElementTree.Element) -> Any:
    """The `MjModel` of an MJCF."""
    return mujoco().MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))
