"""Sets up the course and runs it: the one script behind `make lab`, `make test` and the others.

Usage, on Windows too::

    python course.py lab        open the course in JupyterLab
    python course.py test       run every test and every notebook
    python course.py check      two minutes of these: this machine, some tests, one notebook
    python course.py course     execute the notebooks in order, leave pages in build/course
    python course.py docs       check the spelling, build the site in build/site
    python course.py slides     make slides from the notebooks in build/slides
    python course.py homework   make student and autograder versions of the homework, and try them
    python course.py release    build and try sdist, wheel and site; print how to publish them
    python course.py bridge     run the pages on LeRobot, torchcfm and flow_matching with these
    python course.py setup      only set up

It needs Python 3.11 to 3.13 and its standard library. Everything it writes stays in this folder:
the environment in `.venv`, results in `build`. What follows goes on to the command: options of
JupyterLab (`lab --port 9999`), notebooks (`slides 03 04`), files of tests (`test tests/flows`).
"""

from __future__ import annotations

import contextlib
import difflib
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
PYTHON = VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
STAMP = VENV / "cotlearn-stamp.txt"  #: written last, so only a finished environment has it
SECONDS_TO_END = 6  #: after Ctrl-C, and again when it was passed on
DISK = 3.0  #: gigabytes, with the CPU build of torch
#: Judges of tests, installed without what they ask for: an older pymunk, torchvision with CUDA.
JUDGES = ("gym-pusht", "torchcfm")


def set_up(extras: str) -> None:
    """Makes sure that `.venv` is whole and up to date; what was interrupted goes on."""
    enough = {fingerprint(extras), fingerprint("dev,peers")}
    if STAMP.exists() and STAMP.read_text() in enough and is_whole():
        return
    base, start = find_python(), time.monotonic()
    announce()
    if not can_run(PYTHON, "import pip._internal.cli.main"):
        create(base)
    install("--editable", f".[{extras}]")
    install("--no-deps", *JUDGES)
    if not is_whole():
        sys.exit(f"The environment is damaged: remove {VENV} and run the same command again.")
    STAMP.write_text(fingerprint(extras))
    print(f"Set up in {time.monotonic() - start:.0f} s.", flush=True)


def fingerprint(extras: str) -> str:
    """Returns a hash of all that the environment depends on, its place included."""
    digest = hashlib.sha256(f"{ROOT} {extras}".encode())
    for name in ("pyproject.toml", "constraints.txt"):
        # Git may change the line ends on Windows.
        digest.update((ROOT / name).read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def is_whole() -> bool:
    """Tells whether the environment's Python finds this checkout and the packages."""
    home = str(ROOT / "cotlearn" / "__init__.py")
    there = "import cotlearn, importlib.util as u; assert u.find_spec('torch')"
    return can_run(PYTHON, f"{there} and u.find_spec('nbval') and cotlearn.__file__ == {home!r}")


def find_python() -> str:
    """Returns a supported Python that can make environments: this one, or another on the PATH."""
    supported = ["python3.13", "python3.12", "python3.11"]
    this = "python{}.{}".format(*sys.version_info)
    for name in [sys.executable] if this in supported else supported:
        python = shutil.which(name)
        if python and can_run(python, "import venv, ensurepip"):
            return python
    sys.exit(
        f"The course needs Python 3.11 to 3.13 with its module venv; this is {this}, and no other\n"
        "was found. Install one from python.org, or on Debian and Ubuntu with\n"
        f"    sudo apt install {this if this in supported else 'python3'}-venv\n"
        "and run the same command again."
    )


def announce() -> None:
    """Checks the free space, and says how much will be downloaded."""
    free = shutil.disk_usage(str(ROOT)).free / 1e9
    if free < DISK and not VENV.exists():
        sys.exit(f"Only {free:.1f} GB are free at {ROOT}; the course needs {DISK:.0f} GB.")
    print(f"Setting up in {VENV} (once; 0.5 GB to download, {DISK:.0f} GB on disk).", flush=True)
    there = VENV.exists() and can_run(PYTHON, "import torch")
    if sys.platform == "linux" and "UV_TORCH_BACKEND" not in os.environ and not there:
        print(
            "Note: on Linux torch brings 3.5 GB of CUDA libraries, which the course does not use."
        )
        print("Without them: stop (Ctrl-C), export UV_TORCH_BACKEND=cpu and try again.", flush=True)


def create(base: str) -> None:
    """Makes an environment with pip and uv, in place of any that is there."""
    if VENV.is_symlink():
        VENV.unlink()
    if run(base, "-m", "venv", "--clear", VENV) != 0:
        sys.exit(f"{base} -m venv {VENV} failed; the lines above say why.")
    if not shutil.which("uv"):
        run(PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "uv")


def install(*what: str) -> None:
    """Installs at the exact versions: with uv, which takes a tenth of the time, or with pip."""
    print(f"Installing {' '.join(what)} ...", flush=True)
    uv = shutil.which("uv", path=environment()["PATH"])
    options = ["--quiet", "--constraint", "constraints.txt"]
    done = threading.Event()
    threading.Thread(target=count_minutes, args=[done], daemon=True).start()
    try:
        if uv and run(uv, "pip", "install", *what, *options) == 0:
            return
        if uv:
            print("uv could not; pip tries now, which takes some minutes ...", flush=True)
        if "UV_TORCH_BACKEND" in os.environ:
            print("pip does not know UV_TORCH_BACKEND: it takes PyTorch's usual build,", end=" ")
            print("several GB on Linux (Ctrl-C stops it)", flush=True)
        if run(PYTHON, "-m", "pip", "install", *what, *options) == 0:
            return
    finally:
        done.set()
    sys.exit("The installation failed; the lines above say why. Is the network reachable?")


def count_minutes(done: threading.Event) -> None:
    """Says each minute that the installation goes on."""
    minutes = 0
    while not done.wait(60):
        minutes += 1
        print(f"installing, {minutes} min so far ...", flush=True)


def commands(words: list[str]) -> dict[str, list[list[str]]]:
    """Returns the programs that each command runs, one after the other."""
    site = ["-nqW", "--keep-going", "-c", "docs", "-d", "build/doctrees", ".", "build/site"]
    tried = ["tests/course/test_mistakes.py", "tests/course/test_masters.py"]
    some = ["tests/couplings/test_base.py", "tests/flows/test_solvers.py", "tests/test_mixtures.py"]
    some += ["--nbval-lax", "--nbval-current-env", "notebooks/01_flow_matching_in_2d.ipynb"]
    return {
        "lab": [["cotlearn", "lab", *words]],
        "check": [["cotlearn", "doctor"], ["python", "-m", "pytest", "-q", *some]],
        "course": [["cotlearn", "run", "--html", "build/course", *words]],
        "docs": [["codespell"], ["sphinx-build", *site]],
        "slides": [["python", "docs/slides.py", "build/slides", *words]],
        "homework": [["cotlearn", "homework", *words], ["python", "-m", "pytest", "-q", *tried]],
        "release": [["python", "release.py", *words]],
        "bridge": [["python", "tests/bridge/with_lerobot.py", *words]],
        "setup": [],
    }


def test(words: list[str]) -> int:
    """Runs all checks, tests and notebooks, though one fails; the last line is pytest's."""
    checks = ["ruff check", "ruff format --check", "mypy", "lint-imports"]
    failed = [check for check in checks if program(*check.split()) != 0]
    os.environ["COTLEARN_FAILED"] = ", ".join(failed)
    # A file of tests or a notebook goes to one of two workers, in the order of tests/conftest.py.
    pytest = ["-m", "pytest", "-n", "2", "--dist", "loadfile", "--nbval-lax", "--nbval-current-env"]
    pytest += ["--nbval-cell-timeout=300", *(words or ["notebooks", "tests"])]
    return program("python", *pytest) or len(failed)


def program(name: str, *words: str) -> int:
    """Runs a program of the environment; returns its exit status."""
    print(f"\n=== {name} {' '.join(words)}"[:95], flush=True)
    if name == "sphinx-build":
        print("building the site, a minute or two ...", flush=True)
    return run(PYTHON.parent / name, *words)


def run(*words: str | Path, quiet: bool = False) -> int:
    """Runs a command in this folder; returns its exit status."""
    output = subprocess.DEVNULL if quiet else None
    command = [str(word) for word in words]
    child = subprocess.Popen(
        command, cwd=str(ROOT), env=environment(), stdout=output, stderr=output
    )
    try:
        return child.wait()
    except KeyboardInterrupt:
        end(child)
        raise


def end(child: subprocess.Popen[bytes]) -> None:
    """Lets an interrupted program put its things in order, and ends it if that takes too long.

    In a terminal Ctrl-C reached it, too; a signal to this process alone has to be passed on. Killed
    at once, it would leave its own children running: a server, kernels, workers.
    """
    for patience in (SECONDS_TO_END, SECONDS_TO_END):
        with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            child.wait(patience)
        if child.poll() is not None:
            return
        if os.name != "nt":
            child.send_signal(signal.SIGINT)
    child.kill()


def can_run(python: str | Path, code: str) -> bool:
    """Tells whether a Python is there and runs this code, which sees nothing of this folder."""
    return shutil.which(str(python)) is not None and run(python, "-Ic", code, quiet=True) == 0


def environment() -> dict[str, str]:
    """Returns the environment of child processes: nothing of the user's Python leaks in.

    Without bytecode every process would compile all that it imports, for five seconds.
    """
    leaks = {"PYTHONPATH", "PYTHONHOME", "PYTHONWARNINGS", "PYTHONSTARTUP", "PIP_TARGET"}
    leaks |= {"PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX"}
    leaks |= {"PIP_PREFIX", "PIP_REQUIRE_VIRTUALENV", "PIP_USER", "__PYVENV_LAUNCHER__"}
    kept = {key: value for key, value in os.environ.items() if key not in leaks}
    for name in ("FIND_LINKS", "INDEX_URL"):  # uv does not read what pip was told
        if f"PIP_{name}" in kept:
            kept.setdefault(f"UV_{name}", kept[f"PIP_{name}"])
    kept["PATH"] = str(PYTHON.parent) + os.pathsep + kept.get("PATH", "")  # for `!pip`, too
    return {**kept, "VIRTUAL_ENV": str(VENV), "PYTHONNOUSERSITE": "1", "PYTHONUTF8": "1"}


def main(arguments: list[str]) -> int:
    """Runs one of the commands; returns the exit status."""
    name, words = (arguments or ["help"])[0], arguments[1:]
    steps = commands(words)
    if name not in {*steps, "test"}:
        near = difflib.get_close_matches(name, [*steps, "test"], n=1)
        hint = f"; did you mean {near[0]}?" if near else ""
        print(f"{__doc__}\nthere are: test, {', '.join(steps)}; got {name}{hint}")
        return 2
    try:
        peers = name == "homework" or os.environ.get("COTLEARN_PEERS") == "1"
        set_up("dev,peers" if peers else "dev")
        if name in {"test", "check"}:  # threads of two notebooks would wait for each other
            os.environ.update(OMP_NUM_THREADS="1", PYDEVD_DISABLE_FILE_VALIDATION="1")
            os.environ["COTLEARN_PROGRESS"] = "0"
        if name == "test":
            return test(words)
        failed = next(filter(None, (program(*step) for step in steps[name])), 0)
        if name == "docs" and not failed:
            print(f"to read: {ROOT / 'build' / 'site' / 'index.html'}")
        return failed
    except KeyboardInterrupt:
        print("\nstopped; run the same command again to go on", flush=True)
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
