"""The recipe for hosted notebooks works in the process that runs it, without a restart."""

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how_to" / "run_on_windows_macos_colab.md"
sys.path.insert(0, str(ROOT / "docs" / "extensions"))

import colab  # noqa: E402

#: What a hosted notebook does: this process is running before the course is installed.
HOSTED = """
import importlib.util, subprocess, sys
assert importlib.util.find_spec("cotlearn") is None
command = [sys.executable, "-m", "pip", *sys.argv[1:]]
subprocess.run(command, check=True)
import os, cotlearn
from cotlearn.course import assets
assert assets.checkout() is None, assets.checkout()
os.chdir("course/notebooks")
assert len(assets.notebooks()) > 10
assert assets.find_data(next(iter(assets.sums())))
print("learns", cotlearn.__file__)
"""


def commands():
    """The lines of the recipe."""
    return re.findall(r"^    ([!%].*)", PAGE.read_text("utf-8"), re.MULTILINE)


def test_the_recipe_names_its_copy_by_a_path():
    """By a bare name pip would ask a registry, where the name is somebody else's."""
    clone, install, _ = commands()
    folder = clone.split()[-1]
    assert colab.PLACE in clone
    assert install.split()[-1] == f'"./{folder}[course]"'


@pytest.mark.slow
def test_the_recipe_works_without_a_restart(tmp_path):
    """With -e, as it was, the process that installed it did not find it."""
    pytest.importorskip("pip")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", tmp_path / "host"], check=True)
    python = tmp_path / "host" / ("Scripts" if sys.platform == "win32" else "bin") / "python"
    places = "import sysconfig; print(sysconfig.get_path('purelib'))"
    own = subprocess.run([python, "-Ic", places], capture_output=True, text=True, check=True)
    packages = sysconfig.get_path("purelib")  # but not what its .pth files add: our checkout
    (Path(own.stdout.strip()) / "packages.pth").write_text(f"{packages}\n")
    (tmp_path / "course").symlink_to(ROOT, target_is_directory=True)
    words = commands()[1].replace('"', "").removeprefix("%pip ").split()
    offline = ["--no-deps", "--no-build-isolation", "--no-index", "--ignore-installed"]
    command = [python, "-c", HOSTED, *words, *offline]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    options = {"cwd": tmp_path, "env": clean, "capture_output": True, "text": True}
    done = subprocess.run(command, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "learns" in done.stdout


@pytest.mark.parametrize("end", ["", ".git", "/"])
def test_colab_opens_the_notebook_of_a_page(end):
    page = "notebooks/laboratory/03_skew_on_paper_and_images"
    found = colab.in_colab(f"https://github.com/some/course{end}", page)
    assert found == f"{colab.COLAB}/some/course/blob/main/{page}.ipynb"
    assert (ROOT / f"{page}.ipynb").exists()


def test_colab_reads_no_other_host_and_no_other_page():
    assert colab.in_colab("https://example.org/some/course", "notebooks/00_start_here") == ""
    assert colab.in_colab("https://github.com/some/course", "docs/index") == ""
    assert colab.in_colab("", "notebooks/00_start_here") == ""


def test_the_address_has_one_place(tmp_path):
    file = tmp_path / "pyproject.toml"
    file.write_text("[project]\nname = 'x'\n")
    assert colab.address(file) == ""
    file.write_text("[project.urls]\nRepository = 'https://example.org/x'\n")
    assert colab.address(file) == "https://example.org/x"
