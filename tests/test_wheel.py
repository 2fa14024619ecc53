"""What a release needs: one version everywhere, and a wheel that carries the course.

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
def test_the_wheel_carries_the_course(tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    [wheel] = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"cotlearn-{cotlearn.__version__}-")
    assert wheel.stat().st_size < 100e6, "larger than PyPI takes"
    site, empty = tmp_path / "site", tmp_path / "empty"
    zipfile.ZipFile(wheel).extractall(site)
    empty.mkdir()
    assert (site / "cotlearn" / "py.typed").is_file()
    licences = {path.name for path in site.rglob("LICENSE*")}
    assert licences == {"LICENSE", "LICENSE-TEXT.md"}
    start = f"import sys; sys.path.insert(0, {str(site)!r}); from cotlearn.cli import main; main()"
    lab = [sys.executable, "-I", "-c", start, "lab", "--to", "my course", "--version"]
    subprocess.run(lab, cwd=empty, check=True, capture_output=True)
    copied = sorted((empty / "my course").rglob("*.ipynb"))
    copied[0].write_text("my own")
    subprocess.run(lab, cwd=empty, check=True, capture_output=True)  # copies nothing over
    there = (ROOT / "notebooks").rglob("*.ipynb")
    there = {path.name for path in there if path.parent.name != ".ipynb_checkpoints"}
    assert {path.name for path in copied} == there
    assert copied[0].read_text() == "my own"
