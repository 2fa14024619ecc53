"""Runs the unit tests with the oldest and the newest supported dependencies: `make versions`.

    python release/versions.py [oldest] [newest] [--torch VERSION] [--workers N]

The oldest are the lower bounds of pyproject.toml, the newest what the package index has today
within the upper bounds; uv finds both sets. Each goes into an environment of its own in
build/versions, with this checkout, and the unit tests run there. torch is large and brings CUDA on
Linux: --torch takes one version for both, such as a CPU build that pip finds (UV_FIND_LINKS).
"""

import argparse
import os
import sys
from pathlib import Path

from environments import ROOT, new_environment, run

OUT = ROOT / "build" / "versions"
RESOLUTIONS = {"oldest": "lowest-direct", "newest": "highest"}


def tested(name: str, uv: Path, *, torch: str | None, workers: int) -> bool:
    """Make the environment `name`, run the tests in it, and return whether they passed."""
    wanted, fixed = OUT / f"{name}.txt", OUT / "torch.txt"
    fixed.write_text(f"torch=={torch}\n" if torch else "")
    resolve: list[str | Path] = [uv, "pip", "compile", "--quiet", "--upgrade", "--no-annotate"]
    resolve += ["--no-header", "--resolution", RESOLUTIONS[name], "--extra", "dev"]
    resolve += ["--python-version", ".".join(map(str, sys.version_info[:2]))]
    if run([*resolve, "pyproject.toml", "--constraint", fixed, "--output-file", wanted]) != 0:
        return False
    python = new_environment(OUT / name)
    install: list[str | Path] = [uv, "pip", "install", "--quiet", "--python", python]
    if run([*install, "--requirement", wanted]) or run([*install, "--no-deps", "--editable", "."]):
        return False
    at_a_time = ["-n", str(workers), "--dist", "loadfile"]
    return (
        run(
            [python, "-m", "pytest", "-q", *at_a_time, "-p", "no:cacheprovider"],
            PATH=str(python.parent) + os.pathsep + os.environ.get("PATH", ""),
            COTLEARN_PROGRESS="0",
            OMP_NUM_THREADS="1",
            PYDEVD_DISABLE_FILE_VALIDATION="1",
        )
        == 0
    )


def main() -> int:
    """Test one set or both; 1 if one failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="oldest newest", help="both without a name")
    parser.add_argument("--torch", help="this version of torch in both sets")
    parser.add_argument("--workers", type=int, default=2, help="tests at a time (2)")
    given = parser.parse_args()
    unknown = set(given.names) - set(RESOLUTIONS)
    if unknown:
        parser.error(f"there are {' and '.join(RESOLUTIONS)}, got {', '.join(sorted(unknown))}")
    OUT.mkdir(parents=True, exist_ok=True)
    tools = new_environment(OUT / "tools")
    if run([tools, "-m", "pip", "install", "--quiet", "uv"]) != 0:
        return 1
    uv = next(path for path in tools.parent.iterdir() if path.stem == "uv")
    passed = {
        name: tested(name, uv, torch=given.torch, workers=given.workers)
        for name in given.names or RESOLUTIONS
    }
    for name, good in passed.items():
        print(f"{name}: {'passed' if good else 'FAILED'} (versions: {OUT / name}.txt)")
    return 0 if all(passed.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
