"""Makes a release and tries it: what `make release` runs.

    python release/make.py         # into build/release

It takes what is committed, nothing else: builds the source distribution, a wheel from that and a
wheel from the checkout, which must be the same file; lets twine read them; installs the wheel with
the exact versions of constraints.txt in an empty environment, far from the checkout, and runs
`release/try_wheel.py` there. It downloads what pip has not cached.
"""

import filecmp
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from environments import ROOT, new_environment, run

OUT = ROOT / "build" / "release"


def must(*command: str | Path, folder: Path) -> None:
    """Run a command; its failure ends the program."""
    if run(list(command), folder=folder) != 0:
        sys.exit("the release is not whole: the command above failed")


def committed(folder: Path) -> Path:
    """Copy what is committed to a folder, and say so where that is not what lies here."""
    must("git", "clone", "--quiet", "--no-hardlinks", ROOT, folder, folder=ROOT)
    status = subprocess.run(
        ["git", "status", "--porcelain"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    if status.stdout:
        print("note: there are changes that are not committed; the release is without them")
    return folder


def build(source: Path, tools: Path) -> Path:
    """Build into build/release and return the wheel.

    Both wheels are compared byte for byte.
    """
    shutil.rmtree(OUT, ignore_errors=True)
    again = source.parent / "again"
    must(tools, "-m", "build", "--outdir", OUT, source, folder=source)  # the wheel from the sdist
    must(tools, "-m", "build", "--wheel", "--outdir", again, source, folder=source)
    [wheel] = OUT.glob("*.whl")
    if not filecmp.cmp(wheel, again / wheel.name, shallow=False):
        sys.exit(f"the wheel from {source} is another one than that from the source distribution")
    must(tools, "-m", "twine", "check", "--strict", *sorted(OUT.iterdir()), folder=OUT)
    return wheel


def main() -> None:
    """Make the release and try it."""
    with tempfile.TemporaryDirectory(prefix="cotlearn release ") as name:
        folder = Path(name)
        source = committed(folder / "source")
        tools = new_environment(folder / "tools")
        must(tools, "-m", "pip", "install", "--quiet", "build", "twine", folder=folder)
        wheel = build(source, tools)
        python = new_environment(folder / "empty")
        (elsewhere := folder / "elsewhere").mkdir()
        wanted = [f"{wheel}[course]", "-c", str(source / "constraints.txt")]
        must(python, "-m", "pip", "install", "--quiet", *wanted, folder=elsewhere)
        script = shutil.copy(source / "release" / "try_wheel.py", folder)
        must(python, "-I", script, "--run", folder=elsewhere)
    for file in sorted(OUT.iterdir()):
        print(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
