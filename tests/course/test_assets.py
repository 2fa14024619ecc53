import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cotlearn.cli import app
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
    with pytest.raises(ValueError, match=r"did you mean: 00_start_here\?$"):
        assets.find_notebook("00_start_hear")
    with pytest.raises(ValueError, match="available: 00_start_here, 01_first, 10_last"):
        assets.find_notebook("zzz")


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


def test_an_installed_package_finds_the_checkout_that_it_is_used_in(tmp_path, monkeypatch):
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "site-packages" / "cotlearn")
    monkeypatch.chdir(tmp_path)
    assert assets.checkout() is None
    with pytest.raises(ValueError, match="not part of the installed package: clone or unpack"):
        assets.find_data("push_t_demos.npz")
    root = Path(__file__).resolve().parents[2]
    monkeypatch.chdir(root / "notebooks" / "extras")
    assert assets.checkout() == assets.course_folder() == root


def test_the_library_alone_gets_findings_and_sentences(tmp_path, monkeypatch):
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "site-packages" / "cotlearn")
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code in {0, 1}, result.exception
    said = " ".join(result.output.split())
    assert "library only: no notebooks here" in said
    assert "The course: clone or unpack it" in said
    assert all(name in said for name in ("torch", "disk"))
    assert "Needed and not there: notebooks" not in said
    for words in (["progress"], ["check", "hw1.ipynb"], ["play", "--out", "p.html"]):
        result = CliRunner().invoke(app, words)
        assert (result.exit_code, result.output.count("\n")) == (2, 1)
        assert "clone or unpack the course" in result.output


def test_a_folder_that_was_removed_is_no_checkout(tmp_path, monkeypatch):
    monkeypatch.setattr(assets, "_PACKAGE", tmp_path / "site-packages" / "cotlearn")
    (gone := tmp_path / "gone").mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert assets.checkout() is None


def test_this_checkout_is_found():
    assert assets.checkout() == Path(__file__).resolve().parents[2]
