"""Files are whole: the old one or the new one, whatever happens in between."""

import os
import subprocess
import sys
import textwrap

import pytest

from cotlearn.files import atomic_path, write_text


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
