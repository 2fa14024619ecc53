"""Atomic writes: a reader sees either the complete old file or the complete new one."""

import contextlib
import errno
import os
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
