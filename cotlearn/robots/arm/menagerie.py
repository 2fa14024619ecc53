"""The looks of the real arm: MuJoCo Menagerie's meshes of the Franka Panda over our own physics.

The meshes are not part of this package (Apache License 2.0, google-deepmind/mujoco_menagerie).
They are taken from a folder, or fetched once by the package robot_descriptions for those online.
"""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from xml.etree import ElementTree

FOLDER = "COTLEARN_PANDA"  #: environment variable: a folder with Menagerie's panda.xml
_FILE = "panda_nohand.xml"


def find() -> Path:
    """The folder of the model, from `COTLEARN_PANDA` or the package robot_descriptions.

    Raises:
        ModuleNotFoundError: neither is there.
        FileNotFoundError: the folder does not hold the model, or it cannot be fetched.
    """
    chosen = os.environ.get(FOLDER)
    if chosen is None:
        try:
            module = importlib.import_module("robot_descriptions.panda_mj_description")
        except ModuleNotFoundError as error:
            raise ModuleNotFoundError(
                "model='menagerie' needs the meshes of MuJoCo Menagerie: install "
                "robot_descriptions, which fetches them, or let the environment variable "
                f"{FOLDER} name the folder franka_emika_panda of a copy",
                name="robot_descriptions",
            ) from error
        except Exception as error:  # git's own, whatever it is
            raise FileNotFoundError(
                f"MuJoCo Menagerie cannot be fetched ({error}): are you online?"
            ) from error
        chosen = module.PACKAGE_PATH
    folder = Path(chosen)
    if not (folder / _FILE).is_file():
        raise FileNotFoundError(f"{folder} holds no {_FILE}: is it Menagerie's Panda?")
    return folder


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
        visible = [geom for geom in other.findall("geom") if geom.get("class") == "visual"]
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
