"""The looks of the real arm: MuJoCo Menagerie's meshes of the Franka Panda over our own physics.

The meshes are not part of this package (Apache License 2.0, google-deepmind/mujoco_menagerie).
They come from a copy of Menagerie, or are fetched once for those online by one of the packages
mujoco-menagerie and robot_descriptions.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from xml.etree import ElementTree

ROOT = "MENAGERIE_ROOT"  #: environment variable: the folder of a copy of Menagerie
_ARM, _FILE = "franka_emika_panda", "panda_nohand.xml"


def find() -> Path:
    """The folder of the model.

    Raises:
        ModuleNotFoundError: there is neither a copy nor a package that fetches one.
        FileNotFoundError: the folder does not hold the model, or it cannot be fetched.
    """
    root = os.environ.get(ROOT)
    folder = Path(root) / _ARM if root else _fetched()
    if not (folder / _FILE).is_file():
        raise FileNotFoundError(f"{folder} holds no {_FILE}: is it Menagerie's Panda?")
    return folder


def _fetched() -> Path:
    try:
        try:
            return Path(importlib.import_module("mujoco_menagerie").get(_ARM).path())
        except ModuleNotFoundError:
            described = importlib.import_module("robot_descriptions.panda_mj_description")
            return Path(described.PACKAGE_PATH)
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "model='menagerie' needs the meshes of MuJoCo Menagerie: install mujoco-menagerie, "
            f"which fetches them, or let the environment variable {ROOT} name a copy",
            name="mujoco_menagerie",
        ) from error
    except Exception as error:  # each has its own for being offline
        raise FileNotFoundError(
            f"MuJoCo Menagerie's Panda cannot be fetched ({error}): are you online?"
        ) from error


def dress(root: ElementTree.Element, folder: Path) -> None:
    """Shows the meshes of `folder` in place of our capsules in an MJCF; contacts stay ours.

    Both models have the joint frames of the published parameters, so that a mesh stands where the
    capsule of the same link stands.

    Raises:
        ValueError: the model in the folder is built in another way.
    """
    file = folder / _FILE
    theirs = ElementTree.parse(file).getroot()
    bodies = {body.get("name"): body for body in theirs.iter("body")}
    meshes = folder / next((entry.get("meshdir", "") for entry in theirs.iter("compiler")), "")
    (assets,) = root.iter("asset")
    shown: set[str] = set()
    for name in (f"link{number}" for number in range(8)):
        if name not in bodies:
            raise ValueError(f"{file} is not Menagerie's Panda: it has no body {name}")
        (ours,) = (body for body in root.iter("body") if body.get("name") == name)
        visible = [g for g in bodies[name].findall("geom") if "visual" in g.get("class", "")]
        if visible:
            for geom in ours.findall("geom"):
                geom.set("group", "3")  # there, but not shown
        for geom in visible:
            copy = ElementTree.SubElement(ours, "geom", _own_names(geom))
            copy.attrib.update({"class": "look", "type": "mesh", "group": "2"})
            shown.add(geom.get("mesh", ""))
    for entry in theirs.iterfind("asset/*"):
        name = entry.get("name", Path(entry.get("file", "")).stem)
        if entry.tag == "mesh" and name in shown:
            copy = ElementTree.SubElement(assets, "mesh", _own_names(entry))
            place = (meshes / entry.get("file", "")).resolve()
            copy.attrib.update({"name": f"panda {name}", "file": str(place)})
        elif entry.tag == "material":
            ElementTree.SubElement(assets, "material", _own_names(entry))


def _own_names(element: ElementTree.Element) -> dict[str, str]:
    """The attributes of an element of theirs, its names set apart from ours."""
    return {
        key: f"panda {value}" if key in ("name", "mesh", "material") else value
        for key, value in element.attrib.items()
        if key != "class"
    }
