"""Makes a release and tries it: what `make release` runs.

    python release/make.py         # into build/release

It takes what is committed, nothing else: builds the source distribution, a wheel from that and a
wheel from the checkout, which must be the same file; lets twine read them; installs the wheel with
the exact versions of constraints.txt in an empty environment, far from the checkout, and runs
`release/try_wheel.py` there. It builds and checks the site, and packs it for a host of files. At
last it prints the two commands that publish. It downloads what pip has not cached; the site needs
no network.
"""

import filecmp
import re
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


def site(source: Path, version: str) -> Path:
    """Build the site with the packages of this environment, and pack it."""
    must(sys.executable, source / "docs" / "make.py", folder=source)
    name = str(ROOT / "build" / f"cotlearn-{version}-site")
    return Path(shutil.make_archive(name, "zip", source / "build" / "site"))


def stated(source: Path) -> tuple[str, str]:
    """The version and its date, by the rule at the head of CHANGELOG.md; "" if it has no date yet.

    The test of the rule is in tests/test_wheel.py.
    """
    text = (source / "CHANGELOG.md").read_text("utf-8")
    found = re.search(r"^## (\d+\.\d+\.\d+) \((not yet released|\d{4}-\d\d-\d\d)\)$", text, re.M)
    if not found:
        sys.exit("CHANGELOG.md must begin with '## VERSION (YYYY-MM-DD)' or '(not yet released)'")
    return found[1], found[2].replace("not yet released", "")


def main() -> None:
    """Make the release and try it."""
    with tempfile.TemporaryDirectory(prefix="cotlearn release ") as name:
        folder = Path(name)
        source = committed(folder / "source")
        version, date = stated(source)
        tools = new_environment(folder / "tools")
        must(tools, "-m", "pip", "install", "--quiet", "build", "twine", folder=folder)
        wheel = build(source, tools)
        python = new_environment(folder / "empty")
        (elsewhere := folder / "elsewhere").mkdir()
        wanted = [f"{wheel}[course]", "-c", str(source / "constraints.txt")]
        must(python, "-m", "pip", "install", "--quiet", *wanted, folder=elsewhere)
        script = shutil.copy(source / "release" / "try_wheel.py", folder)
        must(python, "-I", script, "--run", folder=elsewhere)
        made = [*sorted(OUT.iterdir()), site(source, version)]
    for file in made:
        print(f"{file.relative_to(ROOT)}: {file.stat().st_size / 1e6:.1f} MB")
    if not date:
        print("A rehearsal: give CHANGELOG.md and CITATION.cff the date, commit, run this again.")
    print("What a maintainer types then (twine comes with: pip install twine):")
    print(f"    twine upload build/release/cotlearn-{version}*")
    print(f"    git tag v{version} && git push origin v{version}")


if __name__ == "__main__":
    main()
