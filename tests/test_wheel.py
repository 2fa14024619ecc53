"""What a release needs: one version everywhere, and a small wheel.

`make release` builds and tries it in an empty environment; here the wheel of this checkout is
unpacked and tried with the packages of this environment, without the network.
"""

import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.version import Version

import cotlearn

ROOT = Path(__file__).resolve().parent.parent


def read(name):
    return (ROOT / name).read_text("utf-8")


def test_the_version_stands_in_one_place_and_the_others_agree():
    project = tomllib.loads(read("pyproject.toml"))
    assert project["project"]["dynamic"] == ["version"]
    assert project["tool"]["hatch"]["version"]["path"] == "cotlearn/__init__.py"
    cited, headings = yaml.safe_load(read("CITATION.cff")), re.compile(r"^## (.+)$", re.MULTILINE)
    released = {}
    for heading in headings.findall(read("CHANGELOG.md")):
        version, date = re.fullmatch(r"([\d.]+) \((not yet released|[\d-]+)\)", heading).groups()
        released[version] = date
    newest, date = next(iter(released.items()))
    assert cited["version"] == newest == cotlearn.__version__
    assert str(cited.get("date-released", "not yet released")) == date
    assert list(released) == sorted(released, key=Version, reverse=True)
    assert "not yet released" not in list(released.values())[1:]


def test_the_citation_is_of_this_project():
    project = tomllib.loads(read("pyproject.toml"))["project"]
    citation = yaml.safe_load(read("CITATION.cff"))
    assert [a["name"] for a in citation["authors"]] == [a["name"] for a in project["authors"]]
    assert citation["license"] == project["license"].split(" AND ")


@pytest.mark.slow
def test_the_wheel_is_the_library_and_finds_a_checkout(tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    [wheel] = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"cotlearn-{cotlearn.__version__}-")
    assert wheel.stat().st_size < 1e6, "the library's wheel is small"
    site, mine = tmp_path / "site-packages", tmp_path / "my course"
    zipfile.ZipFile(wheel).extractall(site)
    assert (site / "cotlearn" / "py.typed").is_file()
    licences = {path.name for path in site.rglob("LICENSE*")}
    assert licences == {"LICENSE", "LICENSE-TEXT.md"}
    path = f"import sys; sys.path.insert(0, {str(site)!r}); "
    pairs = "import numpy, cotlearn.couplings.assignment as a; a.exact_permutation(numpy.eye(64))"
    subprocess.run([sys.executable, "-I", "-B", "-c", path + pairs], check=True)
    assert list(site.rglob("*.nbi")) == [], "pip would not remove them"
    start = path + "from cotlearn.cli import main; main()"

    def lab(folder):
        command = [sys.executable, "-I", "-c", start, "lab", "--to", str(mine), "--version"]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)

    done = lab(tmp_path)
    assert (done.returncode, mine.exists()) == (2, False), done.stderr
    assert "not part of the installed package" in " ".join((done.stdout + done.stderr).split())
    assert lab(ROOT / "notebooks").returncode == 0
    copied = sorted(mine.rglob("*.ipynb"))
    copied[0].write_text("my own")
    assert lab(ROOT).returncode == 0  # copies nothing over
    there = (ROOT / "notebooks").rglob("*.ipynb")
    there = {path.name for path in there if path.parent.name != ".ipynb_checkpoints"}
    assert {path.name for path in copied} == there
    assert copied[0].read_text() == "my own"
