"""Files are whole: the old one or the new one, whatever happens in between."""

import os
import subprocess
import sys
import textwrap

import pytest

from cotlearn.files import (
    atomic_path,
    check_input,
    check_output,
    check_separate,
    write_text,
)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "some.file"


def test_a_text_is_written_as_it_is(tmp_path):
    path = tmp_path / "new" / "folder" / f"{'long' * 60}.csv"
    write_text(path, "é\r\nb\n", encoding="utf-8-sig")
    assert path.read_bytes() == b"\xef\xbb\xbf\xc3\xa9\r\nb\n"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.skipif(os.name == "nt", reason="permissions of Unix")
def test_permissions_are_those_of_the_old_file_or_of_any_new_one(path, tmp_path):
    write_text(path, "old")
    (other := tmp_path / "other").touch()
    assert path.stat().st_mode == other.stat().st_mode
    path.chmod(0o640)
    write_text(path, "new")
    assert path.stat().st_mode & 0o777 == 0o640


@pytest.mark.skipif(os.name == "nt", reason="links of Unix")
def test_a_link_stays_and_its_target_is_replaced(path, tmp_path):
    path.write_text("old")
    (link := tmp_path / "link").symlink_to(path)
    (ahead := tmp_path / "ahead").symlink_to(tmp_path / "not yet")
    write_text(link, "new")
    write_text(ahead, "first")
    assert (link.is_symlink(), path.read_text()) == (True, "new")
    assert (ahead.is_symlink(), (tmp_path / "not yet").read_text()) == (True, "first")


@pytest.mark.skipif(os.name == "nt", reason="pipes of Unix")
def test_a_pipe_is_not_replaced(path):
    os.mkfifo(path)
    with pytest.raises(OSError, match="it is no ordinary file"):
        write_text(path, "new")
    assert path.is_fifo()


def test_an_error_in_the_middle_keeps_the_old_file(path):
    path.write_text("old")

    def write_half():
        with atomic_path(path) as temporary:
            temporary.write_text("half of the n")
            raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_half()
    assert path.read_text() == "old"
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.skipif(os.name == "nt", reason="signals of Unix")
def test_a_process_killed_while_writing_keeps_the_old_file(path):
    path.write_text("old")
    script = f"""
        import os, signal
        from cotlearn.files import atomic_path
        with atomic_path({str(path)!r}) as temporary:
            temporary.write_text("half of the n")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode != 0
    assert path.read_text() == "old"


def test_a_file_can_be_written_or_not_before_the_work(tmp_path):
    assert check_output(tmp_path / "new" / "a.csv", "out") == tmp_path / "new" / "a.csv"
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "file").touch()
    for bad, why in (
        (tmp_path, "out must be a file, got the folder"),
        (tmp_path / "file" / "a.csv", "out cannot be written to .*a.csv: Not a directory"),
        (tmp_path / ("a" * 300), "out cannot be written to .*: File name too long"),
    ):
        with pytest.raises(ValueError, match=why):
            check_output(bad, "out")


@pytest.mark.skipif(os.name == "nt", reason="names and files of Unix")
def test_names_that_are_no_files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("", ".", "/", ".."):
        with pytest.raises(ValueError, match="out must be a file, got the folder"):
            check_output(name, "out")
    os.mkfifo("pipe")
    for name in ("pipe", "/dev/null"):
        with pytest.raises(ValueError, match=f"out must be an ordinary file, got {name}"):
            check_output(name, "out")
    with pytest.raises(FileNotFoundError, match="no such file: pipe"):
        check_input("pipe")
    strange = os.fsdecode(b"caf\xe9.npz")
    for check in (check_input, lambda path: check_output(path, "path")):
        with pytest.raises(ValueError, match=r"path must have a name in UTF-8, got b'caf"):
            check(strange)
    assert check_output("new/caf\xe9.npz", "out").name == "café.npz"


def test_two_paths_of_one_file_are_refused(tmp_path):
    (one := tmp_path / "a.npz").touch()
    (link := tmp_path / "link").symlink_to(one)
    (twin := tmp_path / "twin").hardlink_to(one)
    check_separate(data=one, out=tmp_path / "b.html", model=None)
    for other in (one, link, twin, tmp_path / "no" / ".." / "a.npz"):
        with pytest.raises(ValueError, match=r"data and out must be two files, got .*a\.npz"):
            check_separate(data=one, out=other)
    new = tmp_path / "new"
    with pytest.raises(ValueError, match="out and model must be two files"):
        check_separate(data=one, out=new, model=tmp_path / "." / "new")


def test_a_path_in_a_folder_of_data_is_refused(tmp_path):
    (data := tmp_path / "demos.zarr").mkdir()
    (link := tmp_path / "link").symlink_to(data, target_is_directory=True)
    check_separate(data=data, out=tmp_path / "demos.html", model=tmp_path / "demos.zarr.st")
    for given in (data, link):
        for out in (data / "a.html", link / "new" / "a.html", tmp_path / "no" / ".." / link / "a"):
            with pytest.raises(ValueError, match=f"out must lie outside the folder {given} of dat"):
                check_separate(data=given, out=out)
    check_separate(out=data / "a.html", data=data)  # a folder may be written to
