"""Sets up the course and runs it: the one script behind `make lab`, `make test` and the others.

Usage, on Windows too::

    python course.py lab        open the course in JupyterLab
    python course.py test       run every test and every notebook
    python course.py course     execute the notebooks in order, leave pages in build/course
    python course.py docs       build the site in build/site and check it
    python course.py slides     make slides from the notebooks in build/slides
    python course.py homework   make student and autograder versions of the homework, and try them
    python course.py release    build and try sdist, wheel and site; print how to publish them
    python course.py versions   unit tests with the oldest and the newest supported dependencies
    python course.py setup      only set up

It needs Python 3.11 to 3.13 and its standard library. Everything it writes stays in this folder:
the environment in `.venv`, results in `build`. What follows `lab` goes on to JupyterLab
(`python course.py lab --port 9999`), what follows `course` or `slides` names notebooks
(`course 00 01`).
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BUILD = ROOT / "build"
#: Written last, so that it is there only for a finished environment.
STAMP = VENV / "cotlearn-stamp.json"
#: There while the empty environment is made; left behind when that is interrupted.
UNFINISHED = VENV / "cotlearn-unfinished"

OLDEST, NEWEST = (3, 11), (3, 13)
#: Gigabytes. Measured on Linux with the CPU build of torch; the CUDA build brings the rest.
DOWNLOAD, DOWNLOAD_CUDA = 0.5, 3.5
DISK, DISK_CUDA = 2.0, 9.0
#: Imported by name to see that the environment is whole.
PROBES = ("torch", "ot", "sklearn", "jupyterlab", "nbclient", "nbval", "mujoco", "sphinx")
CELL_TIMEOUT = 300


class Problem(Exception):
    """Something the user has to fix; the message says how."""


# --- set-up -----------------------------------------------------------------------------------


def set_up() -> Path:
    """Makes sure that `.venv` is complete and up to date.

    Returns:
        The environment's Python.

    Raises:
        Problem: If the machine lacks something, or the installation failed.
    """
    python = venv_python()
    if is_ready(python):
        return python
    base = find_python()
    require_venv_module(base)
    check_disk(shutil.disk_usage(str(ROOT)).free / 1e9)
    announce_download(has_torch(python))
    start = time.monotonic()
    if UNFINISHED.exists() or not can_run(python, "import pip._internal.cli.main"):
        create(base)
    install(python)
    if not is_whole(python):
        say("The environment is damaged; building it anew.")
        create(base)
        install(python)
        if not is_whole(python):
            raise Problem(
                "The environment is still not complete: a bug of course.py. Please report it."
            )
    STAMP.write_text(json.dumps({"fingerprint": fingerprint()}), encoding="utf-8")
    say(f"Set up in {time.monotonic() - start:.0f} s.")
    return python


def venv_python() -> Path:
    """Returns the path of the environment's Python, whether it exists or not."""
    return VENV / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def fingerprint() -> str:
    """Returns a hash of all that the environment depends on, its place included."""
    digest = hashlib.sha256(str(ROOT).encode())
    for name in ("pyproject.toml", "constraints.txt"):
        # Git may change the line ends on Windows.
        digest.update((ROOT / name).read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()


def is_ready(python: Path) -> bool:
    """Tells whether the environment was finished for these files, and is still whole."""
    try:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    if UNFINISHED.exists() or stamp != {"fingerprint": fingerprint()}:
        return False
    return is_whole(python)


def is_whole(python: Path) -> bool:
    """Tells whether the environment's Python runs and finds this checkout and the packages."""
    probe = (
        "import sys, pathlib, importlib.util as u, cotlearn;"
        "home = pathlib.Path(cotlearn.__file__).resolve().parent.parent;"
        f"right = {OLDEST} <= sys.version_info[:2] <= {NEWEST};"
        f"right = right and home == pathlib.Path({str(ROOT)!r});"
        f"sys.exit(not right or not all(u.find_spec(name) for name in {PROBES!r}))"
    )
    return can_run(python, probe)


def has_torch(python: Path) -> bool:
    """Tells whether torch is in the environment already."""
    return can_run(python, "import sys, importlib.util as u; sys.exit(not u.find_spec('torch'))")


def can_run(python: Path, code: str) -> bool:
    """Tells whether `python -c code` ends well."""
    try:
        done = subprocess.run(
            [str(python), "-c", code],
            cwd=str(python.parent) if python.parent.exists() else None,
            env=child_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            timeout=120,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def find_python() -> str:
    """Returns a Python of a supported version: this one, or another on the PATH.

    Raises:
        Problem: If there is none.
    """
    if OLDEST <= sys.version_info[:2] <= NEWEST:
        return sys.executable
    for minor in range(NEWEST[1], OLDEST[1] - 1, -1):
        other = shutil.which(f"python3.{minor}")
        if other and can_run(Path(other), "import venv"):
            say(f"This is Python {platform.python_version()}; using {other} instead.")
            return other
    raise Problem(
        f"The course needs Python 3.{OLDEST[1]} to 3.{NEWEST[1]}; this is Python "
        f"{platform.python_version()} at {sys.executable}, and no other was found. Install one "
        "from python.org or with your system's package manager, then run: python3.12 course.py lab"
    )


def require_venv_module(python: str) -> None:
    """Checks that `python` can make environments, which Debian packs separately.

    Raises:
        Problem: If it cannot; names the package to install.
    """
    if can_run(Path(python), "import venv, ensurepip"):
        return
    code = "import sys; print('python%d.%d-venv' % sys.version_info[:2])"
    package = subprocess.run([python, "-c", code], stdout=subprocess.PIPE, check=False)
    raise Problem(
        f"{python} has no complete venv module. On Debian and Ubuntu, install it with:\n"
        f"    sudo apt install {package.stdout.decode().strip() or 'python3-venv'}\n"
        "and run the same command again."
    )


def check_disk(free: float) -> None:
    """Checks the free space, in gigabytes.

    Raises:
        Problem: If the course cannot fit.
    """
    if free < DISK:
        raise Problem(
            f"Only {free:.1f} GB are free where {ROOT} is; the course needs at least "
            f"{DISK:.0f} GB. Free some space and run the same command again."
        )
    if sys.platform == "linux" and free < DISK_CUDA:
        say(f"Note: {free:.1f} GB are free; torch with CUDA would need about {DISK_CUDA:.0f} GB.")


def announce_download(torch_is_there: bool) -> None:
    """Says how much will be downloaded, and how to make it less."""
    if torch_is_there:
        say(f"Completing the environment in {VENV}.")
        return
    say(f"Setting up in {VENV} (once; about {DOWNLOAD} GB to download, {DISK:.0f} GB on disk).")
    if sys.platform == "linux":
        python = shlex.quote(str(venv_python()))
        say(
            "Note: on Linux, the torch that pip finds by itself usually carries the CUDA\n"
            f"libraries, about {DOWNLOAD_CUDA} GB more to download. The course does not use them.\n"
            "To do without, stop now (Ctrl-C), make the environment, install torch into it as\n"
            "PyTorch's page 'Start Locally' (pytorch.org) says for pip and CPU, and try again:\n"
            "    python3 -m venv .venv\n"
            f"    {python} -m pip install torch==2.13.0 ... (the rest as on that page)"
        )


def create(base: str) -> None:
    """Makes an empty environment, in place of any that is there.

    Raises:
        Problem: If that fails.
    """
    if VENV.exists() or VENV.is_symlink():
        say("Removing the unfinished or broken environment.")
        remove(VENV)
    VENV.mkdir()
    UNFINISHED.touch()
    if subprocess.call([base, "-m", "venv", str(VENV)], env=child_environment()) != 0:
        raise Problem(f"{base} -m venv {VENV} failed; the lines above say why.")
    UNFINISHED.unlink()


def remove(path: Path) -> None:
    """Removes a folder, or a link to one without following it."""
    try:
        if path.is_symlink() or path.is_file():
            path.unlink()
        else:
            shutil.rmtree(str(path))
    except OSError as error:
        raise Problem(
            f"{path} could not be removed ({error}). Close programs that use it, remove it by "
            "hand and run the same command again."
        ) from error


def install(python: Path) -> None:
    """Installs the package and all it needs, at the exact versions.

    An installation that was interrupted goes on where it was: pip finishes what is missing.

    Raises:
        Problem: If pip fails.
    """
    if STAMP.exists():
        STAMP.unlink()
    command = [str(python), "-m", "pip", "install", "--editable", ".[dev]"]
    command += ["--constraint", "constraints.txt", "--disable-pip-version-check"]
    if not sys.stdout.isatty():
        command += ["--quiet", "--quiet"]
    say("Installing ...")
    if subprocess.call(command, cwd=str(ROOT), env=child_environment()) != 0:
        raise Problem(
            "The installation failed; the lines above say why. Is the network reachable, and is "
            "there space on the disk? Run the same command again to go on; if that does not help, "
            f"remove {VENV} first."
        )
    # gym-pusht judges our Push-T in a test. It asks for an older pymunk, and for graphics libraries
    # that the test does without, so pip may not look at what it asks for.
    peer = [*command[:4], "--no-deps", "gym-pusht", *command[6:]]
    if subprocess.call(peer, cwd=str(ROOT), env=child_environment()) != 0:
        say("gym-pusht could not be installed; the test that compares Push-T to it is left out.")


def child_environment(**more: str) -> dict[str, str]:
    """Returns the environment for child processes: nothing of the user's Python leaks in."""
    leaks = {"PYTHONPATH", "PYTHONHOME", "PYTHONWARNINGS", "PYTHONSTARTUP", "PIP_TARGET"}
    leaks |= {"PIP_PREFIX", "PIP_REQUIRE_VIRTUALENV", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__"}
    kept = {key: value for key, value in os.environ.items() if key not in leaks}
    always = {"PIP_USER": "0", "PYTHONNOUSERSITE": "1", "PYTHONUTF8": "1"}
    return {**kept, **always, **more}


# --- lab, course, docs, slides ----------------------------------------------------------------


def lab(python: Path, extra: list[str]) -> int:
    """Opens JupyterLab."""
    return call([str(python), "-m", "cotlearn", "lab", *extra], **tools_first())


def course(python: Path, extra: list[str]) -> int:
    """Executes the notebooks in order and leaves pages to read."""
    pages = BUILD / "course"
    pages.mkdir(parents=True, exist_ok=True)
    command = [str(python), "-m", "cotlearn", "run", "--html", str(pages), *extra]
    return call(command, **tools_first())


def docs(python: Path, extra: list[str]) -> int:
    """Builds the site and checks its words, links and figures."""
    if extra:
        raise Problem(f"docs takes no more words, got: {' '.join(extra)}")
    return call([str(python), str(ROOT / "docs" / "make.py")], **tools_first())


def slides(python: Path, extra: list[str]) -> int:
    """Makes slides from the notebooks as they are stored; nothing is executed."""
    return call([str(python), str(ROOT / "docs" / "slides.py"), *extra], **tools_first())


def homework(python: Path, extra: list[str]) -> int:
    """Makes all versions of the homework and tries solutions, stubs and typical wrong answers.

    Raises:
        Problem: If otter-grader cannot be installed.
    """
    if not can_run(python, "import sys, importlib.util as u; sys.exit(not u.find_spec('otter'))"):
        say("Installing otter-grader, about 100 MB (once) ...")
        command = [str(python), "-m", "pip", "install", "--editable", ".[instructor]", "--quiet"]
        command += ["--constraint", "constraints.txt", "--disable-pip-version-check"]
        if call(command) != 0:
            raise Problem("otter-grader could not be installed; the lines above say why.")
    code = call([str(python), "-m", "cotlearn", "homework", *extra], **tools_first())
    if code != 0:
        return code
    tests = [
        str(ROOT / "tests" / "homework" / f"test_{name}.py") for name in ("mistakes", "masters")
    ]
    return call([str(python), "-m", "pytest", "-q", *tests], **tools_first())


def release(python: Path, extra: list[str]) -> int:
    """Builds sdist, wheel and site, tries them, and prints the commands that publish."""
    return call([str(python), str(ROOT / "release" / "make.py"), *extra])


def versions(python: Path, extra: list[str]) -> int:
    """Runs the unit tests with the oldest and the newest dependencies."""
    return call([str(python), str(ROOT / "release" / "versions.py"), *extra])


def tools_first() -> dict[str, str]:
    """Returns a PATH on which the environment's commands come first, for `!pip` in a notebook."""
    return {"PATH": str(venv_python().parent) + os.pathsep + os.environ.get("PATH", "")}


def call(command: list[str], **environment: str) -> int:
    """Runs a command in this folder and returns its exit status."""
    sys.stdout.flush()
    try:
        return subprocess.call(command, cwd=str(ROOT), env=child_environment(**environment))
    except KeyboardInterrupt:
        return 130


# --- test -------------------------------------------------------------------------------------


def test(python: Path, extra: list[str]) -> int:
    """Runs lint, types and import rules, then every test and every notebook in one pytest run.

    It goes on after a failure. The last line is pytest's own; what failed before stands above it.
    """
    if extra:
        raise Problem(f"test takes no more words, got: {' '.join(extra)}")
    run = [str(python), "-m"]
    failed = []
    for name, command in {
        "lint": [*run, "ruff", "check", "."],
        "format": [*run, "ruff", "format", "--check", "."],
        "types": [*run, "mypy"],
        "import rules": [str(python.parent / "lint-imports")],
    }.items():
        heading(name)
        code = call(command, **tools_first())
        if code == 130:
            return code
        failed += [name] if code else []
    heading("tests and notebooks")
    # A file of tests or a notebook goes to one of two workers, in the order of tests/conftest.py.
    pytest = [*run, "pytest", "-n", "2", "--dist", "loadfile"]
    pytest += ["--nbval-lax", "--nbval-current-env", f"--nbval-cell-timeout={CELL_TIMEOUT}"]
    code = call(
        [*pytest, "notebooks", "tests"],
        **tools_first(),
        COTLEARN_FAILED=", ".join(failed),
        COTLEARN_PROGRESS="0",
        OMP_NUM_THREADS="1",
        PYDEVD_DISABLE_FILE_VALIDATION="1",
    )
    return 130 if code == 130 else int(code != 0 or bool(failed))


def heading(name: str) -> None:
    """Prints a line that a part of the tests begins with."""
    say(f"\n=== {name} " + "=" * (74 - len(name)))


# --- command line -----------------------------------------------------------------------------


def say(message: str) -> None:
    """Prints at once, also into a pipe."""
    print(message, flush=True)


COMMANDS = {
    "lab": lab,
    "test": test,
    "course": course,
    "docs": docs,
    "slides": slides,
    "homework": homework,
    "release": release,
    "versions": versions,
    "setup": None,
}


def main(arguments: list[str]) -> int:
    """Runs one of the commands; returns the exit status."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")
    if not arguments or arguments[0] in {"-h", "--help", "help"}:
        print((__doc__ or "").strip())
        return 0
    name, extra = arguments[0], arguments[1:]
    if name not in COMMANDS:
        print(f"unknown command {name!r}; there are: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        python = set_up()
        action = COMMANDS[name]
        return action(python, extra) if action else 0
    except Problem as problem:
        sys.stdout.flush()
        print(f"\n{problem}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("\nstopped; run the same command again to go on", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
