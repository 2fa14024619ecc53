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
    theirs = ElementTree.parse(folder / _FILE).getroot()
    compiler = theirs.find("compiler")
    meshes = folder / ((compiler.get("meshdir") if compiler is not None else None) or "")
    assets, stored = root.find("asset"), theirs.find("asset")
    if assets is None or stored is None:
        raise ValueError(f"{folder / _FILE} has no meshes")
    shown: set[str] = set()
    for number in range(8):
        name = f"link{number}"
        ours, other = root.find(f".//body[@name='{name}']"), theirs.find(f".//body[@name='{name}']")
        if ours is None or other is None:
            raise ValueError(f"{folder / _FILE} has no body {name}")
        visible = [geom for geom in other.findall("geom") if "visual" in geom.get("class", "")]
        if visible:
            for geom in ours.findall("geom"):
                geom.set("group", "3")  # there, but not shown
        for geom in visible:
            copy = ElementTree.SubElement(ours, "geom", _own_names(geom))
            copy.attrib.update({"class": "look", "type": "mesh", "group": "2"})
            shown.add(geom.get("mesh", ""))
    for entry in stored:
        name = entry.get("name", Path(entry.get("file", "")).stem)
        if entry.tag == "mesh" and name in shown:
            copy = ElementTree.SubElement(assets, "mesh", _own_names(entry))
            file = str((meshes / entry.get("file", "")).resolve())
            copy.attrib.update({"name": f"panda {name}", "file": file})
        elif entry.tag == "material":
            ElementTree.SubElement(assets, "material", _own_names(entry))


def _own_names(element: ElementTree.Element) -> dict[str, str]:
    """The attributes of an element of theirs, its names set apart from ours."""
    kept = {key: value for key, value in element.attrib.items() if key != "class"}
    for key in ("name", "mesh", "material"):
        if key in kept:
            kept[key] = "panda " + kept[key]
    return kept
