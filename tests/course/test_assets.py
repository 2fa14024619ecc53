import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from cotlearn.course import assets, doctor


@pytest.fixture
def course(tmp_path, monkeypatch):
    """A course of three notebooks and one data file in a folder with a space."""
    root = tmp_path / "my course"
    (root / "notebooks").mkdir(parents=True)
    for name in ("00_start_here", "01_first", "10_last", "scratch"):
        (root / "notebooks" / f"{name}.ipynb").write_text("{}")
    for room in assets.ROOMS:
        (root / "notebooks" / room).mkdir()
        (root / "notebooks" / room / "01_aside.ipynb").write_text("{}")
    (root / "data" / "deep").mkdir(parents=True)
    (root / "data" / "deep" / "table.npz").write_bytes(b"1")
    (root / "secret.txt").write_text("outside data")
    monkeypatch.setattr(assets, "course_folder", lambda: root)
    monkeypatch.chdir(tmp_path)
    return root


def test_notebooks_come_in_order_and_only_the_numbered(course):
    names = [path.stem for path in assets.notebooks()]
    assert names == ["00_start_here", "01_first", "10_last"]


@pytest.mark.parametrize(
    "name", ["0", "00", "00_start_here", "00_start_here.ipynb", "notebooks/00_start_here.ipynb"]
)
def test_a_notebook_has_many_names(course, name):
    assert assets.find_notebook(name) == course / "notebooks" / "00_start_here.ipynb"


@pytest.mark.parametrize("room", assets.ROOMS)
@pytest.mark.parametrize("name", ["{}/1", "{}/01_aside", "notebooks/{}/01_aside.ipynb"])
def test_a_notebook_of_a_side_room_has_many_names(course, room, name):
    assert assets.find_notebook(name.format(room)) == assets.notebooks(room)[0]
    assert assets.find_notebook("01").stem == "01_first"


def test_any_path_of_a_notebook_will_do(course):
    path = course / "notebooks" / "scratch.ipynb"
    assert assets.find_notebook(str(path)) == path


def test_an_unknown_notebook_names_its_neighbours(course):
    with pytest.raises(ValueError, match="did you mean: 00_start_here") as raised:
        assets.find_notebook("00_start_hear")
    assert "available: 00_start_here, 01_first, 10_last" in str(raised.value)


@pytest.mark.parametrize("name", ["", "7", "elsewhere/00_start_here.ipynb", "zzz"])
def test_what_is_not_there_is_an_error(course, name):
    with pytest.raises(ValueError, match="there is no notebook"):
        assets.find_notebook(name)


def test_data(course):
    assert assets.find_data("deep/table.npz").read_bytes() == b"1"
    with pytest.raises(ValueError, match=r"did you mean: deep/table\.npz"):
        assets.find_data("deep/tables.npz")
    with pytest.raises(ValueError, match="there is no data file"):
        assets.find_data("../secret.txt")


@pytest.mark.parametrize("name", ["deep/table.npz", "demos.npz", "weights/policy.safetensors"])
def test_one_changed_byte_is_refused_by_name(course, name):
    path = course / "data" / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(bytes(1000))
    assets.write_sums()
    assert assets.find_data(name) == path
    assert doctor.check_data().ok
    path.write_bytes(bytes(999) + b"1")
    said = rf"data/{name} is damaged: its SHA-256.*to restore.*git checkout -- data/{name}"
    with pytest.raises(ValueError, match=said):
        assets.find_data(name)
    finding = doctor.check_data()
    assert (finding.ok, finding.found) == (False, f"missing or damaged: {name}")
    path.write_bytes(bytes(1000))
    assert assets.find_data(name) == path
    path.unlink()
    assert not doctor.check_data().ok


def test_a_damaged_file_of_a_wheel_is_installed_again(course, monkeypatch):
    assets.write_sums()
    (course / "data" / "deep" / "table.npz").write_bytes(b"2")
    monkeypatch.setattr(assets, "checkout", lambda: None)
    with pytest.raises(ValueError, match=r"pip install --force-reinstall --no-deps \.$"):
        assets.find_data("deep/table.npz")


def test_results_and_texts_have_no_sum(course):
    for name in ("results/mac.json", "results/deep/cell.json", "README.md", ".hidden/part"):
        (course / "data" / name).parent.mkdir(parents=True, exist_ok=True)
        (course / "data" / name).write_text("1")
    assets.write_sums()
    assert list(assets.sums()) == ["deep/table.npz"]
    (course / "data" / "results" / "mac.json").write_text("2")
    assert assets.find_data("results/mac.json").read_text() == "2"


def test_the_sums_are_those_of_the_files():
    assert assets.sums() == assets.measured_sums(), "run: python -m cotlearn.course"


def test_a_person_can_refresh_and_check_them():
    path = assets.data_folder() / assets.SUMS
    before = path.read_bytes()
    try:
        command = [sys.executable, "-m", "cotlearn.course"]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout.encode() == path.read_bytes() == before
    finally:
        path.write_bytes(before)


def test_copies_never_overwrite(course, tmp_path):
    target = tmp_path / "of mine"
    target.mkdir()
    (target / "01_first.ipynb").write_text("my work")
    copied, kept = assets.copy_notebooks(target)
    names = [path.relative_to(target).as_posix() for path in copied]
    aside = [f"{room}/01_aside.ipynb" for room in assets.ROOMS]
    assert names == ["00_start_here.ipynb", "10_last.ipynb", *aside]
    assert [path.name for path in kept] == ["01_first.ipynb"]
    assert (target / "01_first.ipynb").read_text() == "my work"
    assert assets.copy_notebooks(target)[0] == []
    with pytest.raises(ValueError, match="folder must be a directory"):
        assets.copy_notebooks(target / "01_first.ipynb")


def test_no_link_of_a_copy_is_dead(tmp_path):
    """Pages of docs/ are not installed, and 19 links led there; now they say where the page is."""
    copied, _ = assets.copy_notebooks(tmp_path / "mine")
    links = re.compile(r"\]\(([^\s():#]+)(?:#[^\s()]*)?\)")
    for path in copied:
        cells = json.loads(path.read_text("utf-8"))["cells"]
        words = "".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")
        dead = [link for link in links.findall(words) if not (path.parent / link).exists()]
        assert dead == [], path.name
    assert "(`docs/speed.md` in a checkout)" in (tmp_path / "mine/02_couplings.ipynb").read_text()


def test_an_installed_wheel_has_the_course_inside(tmp_path, monkeypatch):
    package = tmp_path / "site-packages" / "cotlearn"
    (package / "_course" / "notebooks").mkdir(parents=True)
    monkeypatch.setattr(assets, "_PACKAGE", package)
    assert assets.checkout() is None
    assert assets.course_folder() == package / "_course"


def test_this_checkout_is_found():
    assert assets.checkout() == Path(__file__).resolve().parents[2]
