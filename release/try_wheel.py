"""Tries an installed wheel as its first user would; run in an empty folder, far from the checkout.

    python -I try_wheel.py [--run] [FOLDER]

FOLDER is where the wheel is unpacked, if it is not installed. With --run the doctor must find
everything, and the first notebook is executed, which takes a minute.
"""

import ast
import json
import os
import shutil
import subprocess
import sys
from importlib import metadata
from pathlib import Path

ARGUMENTS = [word for word in sys.argv[1:] if word != "--run"]
sys.path[:0] = ARGUMENTS

import cotlearn  # noqa: E402
from cotlearn import assets, storage  # noqa: E402
from cotlearn.robots import episodes  # noqa: E402


def say(sentence: str, holds: bool) -> None:
    """Print what was looked at; end the program if it does not hold."""
    print("✓" if holds else "✗", sentence, flush=True)
    if not holds:
        sys.exit(1)


def command(*words: str) -> str:
    """Return what `cotlearn` prints for these words."""
    program = "from cotlearn.cli import main; main()"
    paths = "".join(f"sys.path.insert(0, {path!r});" for path in ARGUMENTS)
    done = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys;{paths}{program}", *words],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env={**os.environ, "PYTHONIOENCODING": "utf-8", "COLUMNS": "200"},
        check=False,
    )
    if done.returncode != 0:
        print(done.stdout, done.stderr)
    say(f"cotlearn {' '.join(words)}", done.returncode == 0)
    return done.stdout


def imports(notebook: Path) -> list[str]:
    """Return all import statements of a notebook, one a line; lines of `!` and `%` left out."""
    cells = json.loads(notebook.read_text("utf-8"))["cells"]
    code = "\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "code")
    plain = "\n".join(line for line in code.splitlines() if not line.startswith(("!", "%")))
    found = (n for n in ast.walk(ast.parse(plain)) if isinstance(n, ast.Import | ast.ImportFrom))
    return sorted({ast.unparse(node) for node in found})


def look() -> None:
    """Look for what a wheel must carry."""
    home = Path(cotlearn.__file__).resolve().parent
    say(f"a wheel: {home}", assets.checkout() is None)
    say(f"version {cotlearn.__version__}", metadata.version("cotlearn") == cotlearn.__version__)
    say("types: py.typed", (home / "py.typed").is_file())
    licences = {Path(file).name for file in metadata.files("cotlearn") or []}
    say("both licences", {"LICENSE", "LICENSE-TEXT.md"} <= licences)
    sums = assets.sums()
    say(f"{len(sums)} data files, whole", sums == assets.measured_sums() and len(sums) > 3)
    weights = [name for name in sums if name.endswith(".safetensors")]
    for name in weights:
        storage.load_tensors(assets.find_data(name))
    demos = [name for name in sums if name.endswith("_demos.npz")]
    for name in demos:
        episodes.read(assets.find_data(name))
    say(f"{len(weights)} files of weights and {len(demos)} of demonstrations", bool(weights))


def notebooks() -> None:
    """Copy the notebooks, look that nothing is copied over, and import what they import."""
    folder = Path("my course")
    listed = "--version"  # JupyterLab's own option: it says its version instead of opening
    command("lab", "--to", str(folder), listed)
    copied = sorted(folder.rglob("*.ipynb"))
    expected = [path.name for path in assets.all_notebooks()]
    students = [path.name for path in copied if path.name.startswith("hw")]
    names = sorted(path.name for path in copied)
    say(f"lab copied {len(copied)} notebooks", names == sorted(expected + students))
    say(f"{len(students)} of them homework", len(students) >= 4)
    for notebook in copied:
        for line in imports(notebook):
            exec(line, {})
    say("everything that they import is there", True)
    copied[0].write_text("my own")
    command("lab", "--to", str(folder), listed)
    say("lab copied nothing over", copied[0].read_text() == "my own")
    shutil.copyfile(assets.notebooks()[0], copied[0])


if __name__ == "__main__":
    look()
    notebooks()
    if "--run" in sys.argv:
        print(command("doctor"))
        print(
            command("run", "--timeout", "1800", str(Path("my course") / assets.notebooks()[0].name))
        )
