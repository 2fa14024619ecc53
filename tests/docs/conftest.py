import subprocess
import sys
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def slides(tmp_path_factory):
    """The folder of the slides of notebooks 00 and 03."""
    folder = tmp_path_factory.mktemp("slides")
    command = [sys.executable, "docs/slides.py", str(folder), "00", "03"]
    subprocess.run(command, cwd=Path(__file__).resolve().parents[2], check=True)
    return folder
