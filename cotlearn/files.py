"""Atomic writes, by which a reader sees the old file or the new one whole; checks of paths.

This imports no torch, so a command can refuse a wrong name at once.
"""

import contextlib
import errno
import itertools
import os
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that replaces `path` when the block ends without an error.

    A killed process leaves the old file unchanged. Missing folders are created. The new file gets
    the permissions of the old one, or the default ones. A symbolic link stays, and its target is
    replaced.

    Raises:
        OSError: `path` is a folder, a pipe or a device, or cannot be written.
    """
    path = Path(os.path.realpath(path))
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "it is no ordinary file", str(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.name[:40]}.{uuid.uuid4().hex}"
    temporary.touch(exist_ok=False)
    mode = (path if path.exists() else temporary).stat().st_mode
    try:
        yield temporary
        temporary.chmod(mode)  # safetensors lets only the owner read
        os.replace(temporary, path)
    except OSError as error:  # a full disk gives no name
        if error.errno and not error.filename:
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def reading(path: str | Path, wanted: str) -> Iterator[None]:
    """Turn any error of a reader into a ValueError that names the file.

    Decoders raise errors of many kinds for bytes that are not theirs (zlib, lzma, struct, JSON that
    is too deep), so the block should hold the reader alone.

    Args:
        path: the file.
        wanted: what else it may not be, as "no .npz file".

    Raises:
        ValueError: the block raised an error.
    """
    try:
        yield
    except Exception as error:
        why = str(error).partition(" If you trust")[0]  # NumPy's advice to load it unsafely
        raise ValueError(f"{path} is damaged or {wanted}: {why or repr(error)}") from error


def write_text(path: str | Path, text: str, *, encoding: str = "utf-8") -> None:
    """Writes `text` atomically, with the same line endings on every system."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding=encoding, newline="")


def page(package: str, **values: Any) -> str:
    """The package's `page.html`, filled in; text is escaped, and a missing value is an error."""
    import jinja2  # late: the couplings need none of it

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader(package, "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template("page.html").render(**values)


def check_path(path: Any, name: str) -> Path:
    """Return a path if its name can be written into a page, a table or a terminal."""
    if not isinstance(path, str | Path):
        raise TypeError(f"{name} must be a path, got {path!r}")
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise ValueError(f"{name} must have a name in UTF-8, got {os.fsencode(path)!r}") from None
    if "\0" in str(path):
        raise ValueError(f"{name} must be a path without a NUL character, got {str(path)!r}")
    return Path(path)


def check_input(path: Any, name: str = "path") -> Path:
    """Return a path if there is a file or a folder to read.

    Raises:
        TypeError: it is no path.
        ValueError: its name is not UTF-8.
        FileNotFoundError: there is none; a pipe, which would be read without end, is none.
    """
    path = check_path(path, name)
    if not (path.is_file() or path.is_dir()):
        raise FileNotFoundError(f"no such file: {path}")
    return path


def check_separate(**paths: Path | None) -> None:
    """Raise ValueError if two of these paths are one file, which would be overwritten.

    Nor may a path lie in a folder that comes before it: a folder of data is all that is in it.
    Links are followed, so that two names of one file are found.
    """
    given = {name: path for name, path in paths.items() if path is not None}
    for (first, one), (second, other) in itertools.combinations(given.items(), 2):
        same = os.path.realpath(one) == os.path.realpath(other)
        if same or (one.exists() and other.exists() and one.samefile(other)):
            raise ValueError(f"{first} and {second} must be two files, got {one} for both")
        above = Path(os.path.realpath(other)).parents
        if one.is_dir() and any(folder.exists() and folder.samefile(one) for folder in above):
            raise ValueError(f"{second} must lie outside the folder {one} of {first}, got {other}")


def check_output(path: str | Path, name: str) -> Path:
    """Return a path if a file can be written there, as far as that is known before the work.

    Raises:
        TypeError: it is no path.
        ValueError: it is a folder, a pipe or a device, its name is not UTF-8, or its folder is a
            file or not writable.
    """
    path = check_path(path, name)
    folder = Path(os.path.realpath(path)).parent  # of its target, if it is a link
    try:
        if path.is_dir():
            raise ValueError(f"{name} must be a file, got the folder {path}")
        if path.exists() and not path.is_file():
            raise ValueError(f"{name} must be an ordinary file, got {path}")
        while not folder.exists():  # missing folders will be made
            folder = folder.parent
        with tempfile.TemporaryFile(dir=folder):
            return path
    except OSError as error:
        raise ValueError(f"{name} cannot be written to {path}: {error.strerror}") from None
