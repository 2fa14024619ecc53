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

_FREE_DISK = 1.0  # GB: the course itself writes little
_RENDER = """
import mujoco
model = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size=".1"/></worldbody></mujoco>')
with mujoco.Renderer(model, 32, 32) as renderer:
    renderer.update_scene(mujoco.MjData(model))
    renderer.render()
"""
_GL_REMEDIES = {
    "egl": "sudo apt-get install libegl1 libgl1-mesa-dri",
    "osmesa": "sudo apt-get install libosmesa6",
}


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at."""

    name: str
    found: str
    ok: bool
    #: Whether the course cannot do without it.
    required: bool = True
    #: The command that mends it.
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
    supported = SpecifierSet(metadata.metadata("cotlearn")["Requires-Python"] or ">=3.11")
    version = platform.python_version()
    return Finding(
        name="Python",
        found=f"{version} (supported: {supported}) at {sys.executable}",
        ok=supported.contains(version, prereleases=True),
        remedy="install Python 3.11, 3.12 or 3.13 from python.org, delete .venv, run make lab",
    )


def check_packages() -> list[Finding]:
    """Compares each installed package with the range that the package asks for.

    The packages of the extra `course` are required in a checkout; where only the library was
    installed they are good to have.
    """
    in_checkout = assets.checkout() is not None
    findings = []
    for text in metadata.requires("cotlearn") or []:
        requirement = Requirement(text)
        base = requirement.marker is None or requirement.marker.evaluate({"extra": ""})
        course = requirement.marker is None or requirement.marker.evaluate({"extra": "course"})
        if base or course:
            findings.append(_check_package(requirement, required=base or in_checkout))
    return findings


def _check_package(requirement: Requirement, *, required: bool) -> Finding:
    try:
        version = metadata.version(requirement.name)
    except metadata.PackageNotFoundError:
        version = "missing"
    ok = version != "missing" and requirement.specifier.contains(version, prereleases=True)
    return Finding(
        name=requirement.name,
        found=f"{version} (supported: {requirement.specifier})",
        ok=ok,
        required=required,
        remedy=_install(requirement),
    )


def _install(requirement: Requirement) -> str:
    python = f'"{sys.executable}" -m pip install'
    root = assets.checkout()
    if root is not None:
        return f'{python} -e "{root}[dev]" -c "{root / "constraints.txt"}"'
    return f'{python} "{requirement.name}{requirement.specifier}"'


def check_processor() -> Finding:
    """Counts cores and the threads that torch would use."""
    try:
        import torch

        threads = f", torch uses {torch.get_num_threads()} threads"
    except ImportError:
        threads = ""
    return Finding(
        name="processor",
        found=f"{platform.machine()}, {os.cpu_count()} cores{threads}",
        ok=True,
    )


def check_matplotlib() -> Finding:
    """Draws a small figure."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        figure = Figure(figsize=(1, 1))
        figure.add_subplot().plot([0, 1])
        FigureCanvasAgg(figure).print_png(io.BytesIO())
    except Exception as error:
        found, ok = f"cannot draw: {type(error).__name__}: {error}", False
    else:
        found, ok = "matplotlib draws", True
    return Finding(
        name="figures",
        found=found,
        ok=ok,
        remedy=f'"{sys.executable}" -m pip install --force-reinstall matplotlib',
    )


def check_mujoco() -> list[Finding]:
    """Renders one MuJoCo image with each way of drawing, each in a process of its own.

    None is required: only pictures of the robot arm need one.
    """
    if sys.platform != "linux":
        ok = _renders(backend=None)
        return [Finding("MuJoCo images", "drawn" if ok else "cannot be drawn", ok, required=False)]
    findings = []
    works = {backend: _renders(backend) for backend in _GL_REMEDIES}
    for backend, ok in works.items():
        findings.append(
            Finding(
                name=f"MuJoCo images, {backend}",
                found="drawn" if ok else "cannot be drawn",
                ok=ok or any(works.values()),  # one of the two is enough
                required=False,
                remedy=_GL_REMEDIES[backend],
            )
        )
    return findings


def _renders(backend: str | None) -> bool:
    environment = dict(os.environ)
    if backend is not None:
        environment["MUJOCO_GL"] = environment["PYOPENGL_PLATFORM"] = backend
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RENDER],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
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
        name="data files",
        found=f"missing or damaged: {', '.join(broken)}" if broken else f"{len(expected)} whole",
        ok=not broken,
        remedy=" && ".join(assets.remedy(name) for name in broken),
    )


def check_disk() -> Finding:
    """Looks at the free space where the course is."""
    folder: Path = assets.course_folder()
    free = shutil.disk_usage(folder if folder.exists() else Path.cwd()).free / 1e9
    return Finding(
        name="disk",
        found=f"{free:.1f} GB free",
        ok=free >= _FREE_DISK,
        remedy="free some space, for example with: pip cache purge",
    )
