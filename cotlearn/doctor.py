"""What `cotlearn doctor` looks at: Python, packages, processor, rendering, data, disk."""

from __future__ import annotations

import io
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from cotlearn import assets

FREE_DISK = 1.0  #: GB; the course itself writes little
_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>')
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""
#: The ways in which MuJoCo draws without a screen on Linux, and what installs each.
_GL_REMEDIES = {
    "egl": "sudo apt-get install libegl1 libgl1-mesa-dri",
    "osmesa": "sudo apt-get install libosmesa6",
}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        name: what it is.
        found: how it is.
        ok: whether that will do.
        required: whether the course needs it.
        remedy: the command that fixes it.
    """

    name: str
    found: str
    ok: bool
    required: bool = True
    remedy: str = ""


def examine() -> list[Finding]:
    """Looks at everything; takes a few seconds."""
    return [
        check_python(),
        *check_packages(),
        check_processor(),
        check_matplotlib(),
        *check_mujoco(),
        check_data(),
        check_disk(),
    ]


def check_python() -> Finding:
    """Compares the Python version with the range that the package supports."""
    supported = metadata.metadata("cotlearn")["Requires-Python"]
    version = platform.python_version()
    return Finding(
        "Python",
        f"{version} (supported: {supported}) at {sys.executable}",
        ok=SpecifierSet(supported).contains(version, prereleases=True),
        remedy="install Python 3.11, 3.12 or 3.13 from python.org, delete .venv, run make lab",
    )


def check_packages() -> list[Finding]:
    """Compares each installed package with the range that the package asks for.

    The packages of the extra `course` are required in a checkout; where only the library was
    installed they are good to have.
    """
    root, findings = assets.checkout(), []
    for wanted in map(Requirement, metadata.requires("cotlearn") or []):
        base, course = (
            wanted.marker is None or wanted.marker.evaluate({"extra": extra})
            for extra in ("", "course")
        )
        if not course:
            continue
        try:
            version = metadata.version(wanted.name)
            ok = wanted.specifier.contains(version, prereleases=True)
        except metadata.PackageNotFoundError:
            version, ok = "missing", False
        what = f'"{wanted.name}{wanted.specifier}"'
        if root is not None:
            what = f'-e "{root}[dev]" -c "{root / "constraints.txt"}"'
        findings.append(
            Finding(
                wanted.name,
                f"{version} (supported: {wanted.specifier})",
                ok,
                required=base or root is not None,
                remedy=f'"{sys.executable}" -m pip install {what}',
            )
        )
    return findings


def check_processor() -> Finding:
    """Counts cores and the threads that torch would use."""
    found = f"{platform.machine()}, {os.cpu_count()} cores"
    try:
        import torch

        found += f", torch uses {torch.get_num_threads()} threads"
    except ImportError:
        pass  # `check_packages` says so
    return Finding("processor", found, ok=True)


def check_matplotlib() -> Finding:
    """Draws a small figure."""
    found = "matplotlib draws"
    try:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(1, 1))
        figure.add_subplot().plot([0, 1])
        figure.savefig(io.BytesIO())
    except Exception as error:
        found = f"cannot draw: {type(error).__name__}: {error}"
    return Finding(
        "figures",
        found,
        ok=found == "matplotlib draws",
        remedy=f'"{sys.executable}" -m pip install --force-reinstall matplotlib',
    )


def check_mujoco() -> list[Finding]:
    """Renders one MuJoCo image with each way of drawing, each in a process of its own.

    On Linux one way is enough, and none is required: only pictures of the robot arm need one.
    """
    ways = _GL_REMEDIES if sys.platform == "linux" else {"": ""}
    works = {way: _renders(way) for way in ways}
    return [
        Finding(
            f"MuJoCo images, {way}" if way else "MuJoCo images",
            "drawn" if works[way] else "cannot be drawn",
            ok=any(works.values()),
            required=False,
            remedy=remedy,
        )
        for way, remedy in ways.items()
    ]


def _renders(way: str) -> bool:
    environment = {"MUJOCO_GL": way, "PYOPENGL_PLATFORM": way} if way else {}
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RENDER],
            env=os.environ | environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=60,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def check_data() -> Finding:
    """Compares the data files of the course with their SHA-256 sums."""
    expected, measured = assets.sums(), assets.measured_sums()
    broken = [name for name, digest in expected.items() if measured.get(name) != digest]
    return Finding(
        "data files",
        f"missing or damaged: {', '.join(broken)}" if broken else f"{len(expected)} whole",
        ok=not broken,
        remedy=" && ".join(assets.remedy(name) for name in broken),
    )


def check_disk() -> Finding:
    """Looks at the free space where the course is."""
    folder = assets.course_folder()
    free = shutil.disk_usage(folder if folder.exists() else Path.cwd()).free / 1e9
    remedy = "free some space, for example with: pip cache purge"
    return Finding("disk", f"{free:.1f} GB free", ok=free >= FREE_DISK, remedy=remedy)
