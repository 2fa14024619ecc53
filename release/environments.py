"""What the scripts of this folder share: commands, and environments of their own."""

import os
import subprocess
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def run(command: list[str | Path], *, folder: Path = ROOT, **environment: str) -> int:
    """Show a command, run it in a folder, and return its exit status."""
    words = [str(word) for word in command]
    print("+", " ".join(words), flush=True)
    kept = {k: v for k, v in os.environ.items() if k not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    return subprocess.run(words, cwd=folder, env=kept | environment, check=False).returncode


def new_environment(folder: Path) -> Path:
    """Make an environment with nothing but pip, and return its Python."""
    venv.create(folder, clear=True, with_pip=True)
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
