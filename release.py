"""Makes a release and tries it: what `make release` runs, on `build` and `twine check`.

    python release.py               # into build/release
    python release.py --oldest      # unit tests with the oldest dependencies of pyproject.toml
    python release.py --newest      # and with the newest

It takes what is committed, nothing else; tries the wheel in an empty environment, in a clone of
this checkout; builds and packs the site; and prints the commands that publish.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
OUT = ROOT / "build" / "release"


def run(*command: str | Path, folder: Path = ROOT) -> None:
    """Show a command and run it; its failure ends the program."""
    print("+", *command, flush=True)
    leaks = {"PYTHONPATH", "VIRTUAL_ENV"}
    kept = {key: value for key, value in os.environ.items() if key not in leaks}
    if subprocess.call([str(word) for word in command], cwd=folder, env=kept) != 0:
        sys.exit("the release is not whole: the command above failed")


def new_environment(folder: Path, *packages: str | Path) -> Path:
    """Make an environment with some packages; return the folder of its programs."""
    venv.create(folder, clear=True, with_pip=True)
    programs = folder / ("Scripts" if os.name == "nt" else "bin")
    run(programs / "python", "-m", "pip", "install", "--quiet", *packages, folder=folder)
    return programs


def build(source: Path, tools: Path) -> Path:
    """Build sdist and wheel into build/release, let twine read them, and return the wheel."""
    shutil.rmtree(OUT, ignore_errors=True)
    run(tools / "python", "-m", "build", "--outdir", OUT, source)
    run(tools / "python", "-m", "twine", "check", "--strict", *sorted(OUT.iterdir()))
    [wheel] = OUT.glob("*.whl")
    return wheel


def try_wheel(wheel: Path, source: Path, folder: Path) -> None:
    """Do what a first user does in a checkout: copy the notebooks, ask the doctor, run a lesson."""
    constraints: list[str | Path] = ["--constraint", source / "constraints.txt"]
    programs = new_environment(folder / "empty", f"{wheel}[course]", *constraints)
    for words in ("lab --version", "doctor", "run my-course/00_start_here.ipynb"):
        run(programs / "cotlearn", *words.split(), folder=source)


def build_site(source: Path, version: str) -> Path:
    """Build the site with the packages of this environment, and pack it."""
    sphinx = ["-m", "sphinx", "-nqW", "-c", "docs", ".", "build/site"]
    run(sys.executable, *sphinx, folder=source)
    name = str(OUT / f"cotlearn-{version}-site")
    return Path(shutil.make_archive(name, "zip", source / "build" / "site"))


def stated(source: Path) -> tuple[str, str]:
    """Return the version and its date as CHANGELOG.md states them, "" without a date."""
    text = (source / "CHANGELOG.md").read_text("utf-8")
    found = re.search(r"^## (\d+\.\d+\.\d+) \((not yet released|\d{4}-\d\d-\d\d)\)$", text, re.M)
    if not found:
        sys.exit("CHANGELOG.md must begin with '## VERSION (YYYY-MM-DD)' or '(not yet released)'")
    return found[1], found[2].replace("not yet released", "")


def test_versions(resolution: str) -> None:
    """Run the unit tests with the oldest or the newest dependencies that pyproject.toml allows."""
    folder = ROOT / "build" / resolution
    programs = new_environment(folder, "uv")
    install = ["pip", "install", "--quiet", "--resolution", resolution, "--editable", ".[dev]"]
    run(programs / "uv", *install, "--python", programs / "python")
    run(programs / "python", "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", "tests")


def release() -> None:
    """Make the release, try it, and print the commands that publish."""
    with tempfile.TemporaryDirectory(prefix="cotlearn release ") as name:
        folder = Path(name)
        source = folder / "source"
        run("git", "clone", "--quiet", "--no-hardlinks", ROOT, source)
        version, date = stated(source)
        wheel = build(source, new_environment(folder / "tools", "build", "twine"))
        try_wheel(wheel, source, folder)
        build_site(source, version)
    for file in sorted(OUT.iterdir()):
        print(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e6:.1f} MB")
    if not date:
        print("A rehearsal: give CHANGELOG.md and CITATION.cff the date, commit, run this again.")
    print("What a maintainer types then (pip install twine):")
    print(f"    twine upload build/release/cotlearn-{version}*.whl build/release/*.tar.gz")
    print(f"    git tag v{version} && git push origin v{version}")


if __name__ == "__main__":
    if sys.argv[1:] == ["--oldest"]:
        test_versions("lowest-direct")
    elif sys.argv[1:] == ["--newest"]:
        test_versions("highest")
    else:
        release()
