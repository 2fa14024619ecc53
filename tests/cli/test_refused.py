"""Commands that cannot do their work say so in one sentence, before the work where it is known."""

import io
import os
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import typer
from safetensors import SafetensorError
from typer.testing import CliRunner

from cotlearn import cli, storage
from cotlearn.cli import policies
from cotlearn.course import assets, doctor


def refused(*arguments):
    result = CliRunner().invoke(cli.app, list(map(str, arguments)))
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.count("\n") == 1
    return result.output


@pytest.fixture
def empty(tmp_path, monkeypatch):
    """A course without notebooks and data."""
    monkeypatch.setattr(assets, "course_folder", lambda: tmp_path)
    return tmp_path


def test_a_course_without_files_is_not_well(empty):
    assert not doctor.check_data().ok
    assert "SHA256SUMS" in doctor.check_data().found
    assert not doctor.check_notebooks().ok
    assert "no notebooks in" in refused("run")


def test_an_empty_list_of_sums_vouches_for_nothing(empty):
    (empty / "data").mkdir()
    (empty / "data" / "a.npz").touch()
    (empty / "data" / assets.SUMS).touch()
    assert not doctor.check_data().ok
    with pytest.raises(ValueError, match="data/SHA256SUMS is empty, so no file can be checked"):
        assets.find_data("a.npz")


@pytest.mark.parametrize("command", [("train", "push-t"), ("demos", "push-t"), ("report", "a.npz")])
def test_out_is_looked_at_before_the_work(command, tmp_path):
    assert "out must be a file, got the folder" in refused(*command, "--out", tmp_path)


@pytest.mark.parametrize("out", ["", ".", "/"])
@pytest.mark.parametrize("command", [("train", "push-t"), ("demos", "push-t"), ("report", "a.npz")])
def test_an_out_that_has_no_name(command, out):
    assert "out must be a file, got the folder" in refused(*command, "--out", out)
    assert "out must be a file" in refused("grade", ".", "--out", out)


def test_demonstrations_of_another_task(tmp_path):
    ring = assets.find_data("arm_ring_demos.npz")
    for name in ("arm-avoid", "push-t"):
        for command in ("train", "bench"):
            said = refused(command, name, "--data", ring)
            assert f"holds demonstrations of arm-ring, but {name} needs those of {name}" in said
    setting, episodes = policies.setting("arm-ring", {}, ring)
    assert (setting.task, episodes.task.name) == ("arm-ring", "arm-ring")


def test_data_are_never_overwritten(tmp_path):
    np.savez(data := tmp_path / "mine.npz", x1=np.zeros((9, 2)), c=np.zeros((9, 1)))
    before, page = data.read_bytes(), tmp_path / "page.html"
    same = ["report", data, "--out", page, "--model", page]
    assert "out and model must be two files" in refused(*same)
    assert "data and out must be two files" in refused("report", data, "--out", data)
    assert "data and model must be two files" in refused("report", data, "--model", data)
    assert "out and model" in refused("report", data, "--out", tmp_path / "my.safetensors")
    assert "data and out" in refused("train", "push-t", "--data", data, "--out", data)
    assert data.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["mine.npz"]


@pytest.mark.parametrize("name", ["demos.zarr", "lerobot"])
def test_nothing_is_written_into_a_folder_of_data(tmp_path, monkeypatch, name):
    (data := tmp_path / name).mkdir()
    for out in (data / "r.html", data / "new" / "r.html"):
        assert "out must lie outside the folder" in refused("report", data, "--out", out)
        assert "out must lie outside" in refused("train", "push-t", "--data", data, "--out", out)
    page = tmp_path / "r.html"
    said = refused("report", data, "--out", page, "--model", data / "m.safetensors")
    assert "model must lie outside the folder" in said
    bench = ["bench", "push-t", "--data", data]
    assert "tables must lie outside" in refused(*bench, "--tables", data)
    elsewhere = ["--tables", tmp_path, "--weights", data / "w"]
    assert "weights must lie outside" in refused(*bench, *elsewhere)
    monkeypatch.chdir(data)
    assert "out must lie outside the folder . of data" in refused("report", ".")
    assert not list(data.iterdir())
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["r.pdf", "r", "-", "r.html.b"])
def test_a_page_has_a_name_that_says_so(tmp_path, name):
    """Before, --out r.pdf was HTML."""
    np.savez(data := tmp_path / "mine.npz", x1=np.zeros((9, 2)), c=np.zeros((9, 1)))
    said = refused("report", data, "--out", tmp_path / name)
    assert "--out must end in .html" in said
    assert said.rstrip().endswith(name)


def test_outputs_over_inputs(tmp_path):
    (file := tmp_path / "mine.py").write_text("coupling = 3")
    assert "file and out must be two files" in refused("challenge", file, "--out", file)
    assert "out and page" in refused("challenge", file, "--out", tmp_path / "a.html")
    (film := tmp_path / "a.gif").touch()
    assert "policy and out" in refused("watch", "push-t", "--policy", film, "--out", film)
    assert file.read_text() == "coupling = 3"


def test_pages_and_tables_are_looked_at_before_the_work(tmp_path):
    (file := tmp_path / "file").touch()
    assert "html cannot be written to" in refused("run", "00", "--html", file)
    assert "cannot be written to" in refused("bench", "push-t", "--tables", file)
    assert "out cannot be written to" in refused("homework", "--out", file)
    (tmp_path / "in").mkdir()
    assert "out cannot be written to" in refused("grade", tmp_path / "in", "--out", file / "a.csv")
    assert "executor must be one of local, dask" in refused("bench", "push-t", "--executor", "a")


def test_a_file_that_claims_many_rows(tmp_path):
    header = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 100)}
    np.lib.format.write_array_header_1_0(header, shape)
    path = tmp_path / "large.npz"
    with zipfile.ZipFile(path, "w") as file:
        for name in ("x1", "c"):
            file.writestr(f"{name}.npy", header.getvalue())
    assert "is damaged" in refused("report", path, "--out", tmp_path / "a.html")
    assert "is damaged" in refused("train", "push-t", "--data", path, "--out", tmp_path / "a")


def test_a_zarr_that_claims_many_rows(tmp_path):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(tmp_path / "a.zarr", mode="w", zarr_format=2)
    for name, columns in (("data/state", 5), ("data/action", 2)):
        group.create_array(name, shape=(10**12, columns), chunks=(1000, columns), dtype="f4")
    group.create_array("meta/episode_ends", shape=(1,), dtype="i8")
    assert "is damaged" in refused("train", "push-t", "--data", tmp_path / "a.zarr")
    (tmp_path / "a.zarr" / ".zgroup").write_text("{")
    assert "a.zarr is damaged" in refused("train", "push-t", "--data", tmp_path / "a.zarr")


@pytest.mark.skipif(sys.platform == "win32", reason="no named pipes")
def test_a_pipe_is_no_file_of_data(tmp_path):
    os.mkfifo(tmp_path / "a.npz")
    assert "no such file" in refused("train", "push-t", "--data", tmp_path / "a.npz")
    assert "no such file" in refused("report", tmp_path / "a.npz")


def test_a_full_disk(tmp_path, monkeypatch):
    def full(*arguments, **options):
        raise SafetensorError("No space left on device")

    monkeypatch.setattr(storage, "save_file", full)
    with pytest.raises(OSError, match="a cannot be written: No space left on device"):
        storage.save_tensors(tmp_path / "a", {}, {})
    with pytest.raises(typer.Exit), cli.terminal.reported():
        raise MemoryError("Unable to allocate 7 TiB")


@pytest.mark.parametrize("option", ["--seconds", "--gigabytes"])
def test_limits_are_finite(option, tmp_path):
    assert f"{option[2:]} must be at least" in refused("grade", tmp_path, option, "inf")


@pytest.mark.parametrize("name", ["g.txt", "g.xlsx", "g"])
def test_grades_and_leaderboards_are_tables_in_csv(name, tmp_path):
    """The command wrote CSV into a file that was called otherwise."""
    (tmp_path / "in").mkdir()
    said = refused("grade", tmp_path / "in", "--out", tmp_path / name)
    assert f"out must be a file such as grades.csv, a table in CSV, got {tmp_path / name}" in said
    said = refused("challenge", "--out", tmp_path / name)
    wanted = "out must be a file such as leaderboard.csv (the page lies beside it)"
    assert f"{wanted}, got {tmp_path / name}" in said
    assert "suffix of out must be one of .html" in refused("play", "--out", tmp_path / name)


def test_feedback_does_not_go_to_the_hand_ins(tmp_path):
    (folder := tmp_path / "in").mkdir()
    (inner := folder / "hw1").mkdir()
    for hand_ins in (folder, inner):
        said = refused("grade", hand_ins, "--out", tmp_path / "in.csv")
        assert f"out must have another name than the folder {folder}, got {folder}.csv" in said
        assert (
            f"the pages of the students go to the folder {folder}, where the hand-ins are" in said
        )


CODE = """
import sys
from cotlearn import cli
try:
    cli.app({words!r})
except SystemExit as ended:
    print(ended.code, "torch" in sys.modules)
"""


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", "99"], "there is no notebook '99'"),
        (["check", "03", "99"], "there is no notebook '99'"),
        (["run", "77"], "there is no notebook '77'"),
        (["report", "nope.npz"], "no such file: nope.npz"),
        (["train", "push-t", "--data", "nope.npz"], "no such file: nope.npz"),
        (["bench", "push-t", "--data", "nope.npz"], "no such file: nope.npz"),
        (["challenge", "nope.py"], "no such file: nope.py"),
        (["grade", "nope"], "folder must be a folder of notebooks, got nope"),
        (["grade", ".", "--out", "../{here}.csv"], "out must have another name than the folder"),
        (["watch", "push-t", "--policy", "nope.st"], "no such file: nope.st"),
    ],
)
def test_a_wrong_name_is_refused_before_torch_loads(words, said, tmp_path):
    words = [word.format(here=tmp_path.name) for word in words]
    code = [sys.executable, "-c", CODE.format(words=words)]
    done = subprocess.run(code, capture_output=True, text=True, check=True, cwd=tmp_path)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == "2 False\n"


def test_a_mistyped_option_of_lab_does_not_go_to_jupyterlab():
    result = CliRunner().invoke(cli.app, ["lab", "--frsh", "03"])
    assert result.exit_code == 2
    assert "Did you mean --fresh?" in result.output
