"""The checks of `cotlearn doctor`: Python, packages, processor, rendering, data, disk."""

import io
import os
import platform
import shutil
import sys
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from cotlearn.course import assets

FREE_DISK = 1.0  #: GB that should be free; the course itself writes little


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes:
        name: what was checked.
        found: the state that was found.
        ok: whether that state is good enough.
        required: whether the course needs it.
        remedy: a command that fixes it.
        course: whether it is a package of the extra `course`.
    """

    name: str
    found: str
    ok: bool
    required: bool = True
    remedy: str = ""
    course: bool = False


def examine() -> list[Finding]:
    """Runs all checks, which takes a few seconds."""
    return [
        check_python(),
        *check_packages(),
        check_processor(),
        check_matplotlib(),
        check_mujoco(),
        check_notebooks(),
        check_data(),
        check_disk(),
    ]


def check_python() -> Finding:
    """Compares the Python version with the range that the package supports."""
    supported = metadata.metadata("cotlearn")["Requires-Python"]
    version = platform.python_version()
    found = f"{version} (supported: {supported}) at {sys.executable}"
    fits = SpecifierSet(supported).contains(version, prereleases=True)
    remedy = "install Python 3.11, 3.12 or 3.13 from python.org, delete .venv, run make lab"
    return Finding("Python", found, ok=fits, remedy=remedy)


def check_packages() -> list[Finding]:
    """Compares the version of each dependency with the range that cotlearn supports.

    The packages of the extra `course` are required in a checkout and optional otherwise.
    """
    root, findings = assets.checkout(), []
    for wanted in map(Requirement, metadata.requires("cotlearn") or []):
        marker = wanted.marker
        if marker is not None and not marker.evaluate({"extra": "course"}):
            continue
        try:
            version = metadata.version(wanted.name)
        except metadata.PackageNotFoundError:
            version = "missing"
        what = f'"{wanted.name}{wanted.specifier}"'
        if root is not None:
            what = f'-e "{root}[dev]" -c "{root / "constraints.txt"}"'
        found = f"{version} (supported: {wanted.specifier})"
        fits = version != "missing" and wanted.specifier.contains(version, prereleases=True)
        course = marker is not None and not marker.evaluate({"extra": ""})
        required = root is not None or not course
        remedy = f'"{sys.executable}" -m pip install {what}'
        findings.append(Finding(wanted.name, found, fits, required, remedy, course))
    return findings


def check_processor() -> Finding:
    """Counts the cores and torch's threads."""
    found = f"{platform.machine()}, {os.cpu_count()} cores"
    if find_spec("torch") is not None:
        import torch

        found += f", torch uses {torch.get_num_threads()} threads"
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
    remedy = f'"{sys.executable}" -m pip install --force-reinstall matplotlib'
    return Finding("figures", found, ok=found == "matplotlib draws", remedy=remedy)


def check_mujoco() -> Finding:
    """Finds the backend that renders the robot arm; matplotlib is a plainer fallback for MuJoCo."""
    try:
        from cotlearn.robots.arm.rendering import backend

        how = backend()
    except ImportError:
        how = "nothing"
    remedy = "sudo apt-get install libegl1 libgl1-mesa-dri"
    fast = how not in {"matplotlib", "nothing"}
    return Finding("MuJoCo images", f"drawn by {how}", ok=fast, required=False, remedy=remedy)


def check_notebooks() -> Finding:
    """Counts the notebooks of the course."""
    if assets.checkout() is None:
        return _library_only("notebooks")
    found = len(assets.notebooks())
    remedy = assets.remedy("", folder="notebooks")
    return Finding("notebooks", f"{found} lessons found", ok=found > 0, remedy=remedy)


def check_data() -> Finding:
    """Compares the data files of the course with their SHA-256 sums."""
    if assets.checkout() is None:
        return _library_only("data files")
    expected, measured = assets.sums() or {assets.SUMS: ""}, assets.measured_sums()
    broken = [name for name, digest in expected.items() if measured.get(name) != digest]
    found = f"missing or damaged: {', '.join(broken)}" if broken else f"{len(expected)} whole"
    remedy = " && ".join(assets.remedy(name) for name in broken)
    return Finding("data files", found, ok=not broken, remedy=remedy)


def _library_only(name: str) -> Finding:
    """What an installed package says outside of a checkout; the library works without these."""
    remedy = "clone or unpack the course, and run cotlearn doctor in its folder"
    return Finding(name, f"library only: no {name} here", False, required=False, remedy=remedy)


def check_disk() -> Finding:
    """Checks the free space on the disk that holds the course."""
    free = shutil.disk_usage(assets.checkout() or Path.cwd()).free / 1e9
    remedy = "free some space, for example with: pip cache purge"
    return Finding("disk", f"{free:.1f} GB free", ok=free >= FREE_DISK, remedy=remedy)
