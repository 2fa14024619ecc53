"""Finds the notebooks and data of the course by name, in its checkout.

An installed package has neither; it finds those of the checkout in which it is used.

A data file is checked against its SHA-256 sum in `data/SHA256SUMS` when it is looked up. After a
change of the data, `python -m cotlearn.course` rewrites `data/SHA256SUMS`.
"""

import contextlib
import difflib
import hashlib
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

from cotlearn.files import write_text

#: In the folder `data/`: one line per file, in the format of the program `sha256sum`.
SUMS = "SHA256SUMS"
#: Folders of notebooks beside the path: what a lesson leaves out, and related work.
ROOMS = ("laboratory", "extras")

_PACKAGE = Path(__file__).resolve().parents[1]
_NUMBERED = re.compile(r"\d\d_.*\.ipynb")


def checkout() -> Path | None:
    """Returns the root of the course's checkout, or None.

    It is the one that this package is imported from, or else the one that we are in.
    """
    for root in itertools.chain([_PACKAGE.parent], _here()):
        if all((root / name).is_file() for name in ("course.py", f"data/{SUMS}")):
            return root
    return None


def _here() -> Iterator[Path]:
    """The current folder and those above it; none if it was removed."""
    with contextlib.suppress(OSError):
        here = Path.cwd()
        yield from (here, *here.parents)


def course_folder() -> Path:
    """Returns the folder that holds `notebooks/` and `data/`.

    Raises:
        ValueError: If there is no checkout.
    """
    root = checkout()
    if root is None:
        raise ValueError(
            "the course's notebooks and data are not part of the installed package: clone or "
            "unpack the course, and run this in its folder"
        )
    return root


def notebooks(room: str = "") -> list[Path]:
    """Returns the numbered notebooks of the path in reading order, or those of a side room.

    Args:
        room: "" for the path, or a folder of `ROOMS`.
    """
    folder = course_folder() / "notebooks" / room
    return sorted(path for path in folder.glob("*.ipynb") if _NUMBERED.fullmatch(path.name))


def all_notebooks() -> list[Path]:
    """Returns the notebooks of the path, then those of the side rooms."""
    return [path for room in ("", *ROOMS) for path in notebooks(room)]


def find_notebook(name: str) -> Path:
    """Finds a notebook by number, name or path.

    Args:
        name: A number ("00"), a name ("00_start_here", with or without ".ipynb"), either after
            "laboratory/" or "extras/" for the notebooks there, or the path of any notebook.

    Returns:
        The path of an existing notebook.

    Raises:
        ValueError: If there is no such notebook; the message lists close matches and all notebooks.
    """
    path = Path(name).expanduser()
    if path.suffix == ".ipynb" and path.is_file():
        return path
    stem = path.name.removesuffix(".ipynb")
    room = path.parent.name if path.parent.name in ROOMS else ""
    available = {item.stem: item for item in notebooks(room)}
    if path.parent.as_posix() in {room or ".", f"notebooks/{room}".rstrip("/")}:
        for key, item in available.items():
            if stem == key or (stem.isdigit() and int(stem) == int(key[:2])):
                return item
    raise ValueError(not_found("notebook", name, list(available), wanted=stem))


def find_data(name: str) -> Path:
    """Finds a file in the course's `data/` folder and checks its SHA-256.

    Demonstrations and weights are listed in `data/SHA256SUMS` and are checked; results and texts
    are not.

    Args:
        name: The path relative to `data/`, with forward slashes.

    Returns:
        The path of an existing file.

    Raises:
        ValueError: If there is no such file, `name` points outside the folder, or the file is
            damaged.
    """
    files = _data_files()
    path = (data_folder() / name).resolve()
    listed = next((key for key, file in files.items() if file == path), None)
    if listed is None:
        raise ValueError(not_found("data file", name, sorted(files)))
    expected = sums()
    if not expected and (data_folder() / SUMS).exists():
        raise ValueError(f"data/{SUMS} is empty, so no file can be checked: {remedy(SUMS)}")
    if expected.get(listed) not in (None, _sha256(path)):
        why = f"its SHA-256 is not the one in data/{SUMS}"
        raise ValueError(f"data/{listed} is damaged: {why}; to restore it: {remedy(listed)}")
    return path


def data_folder() -> Path:
    """Returns the folder of demonstrations, weights and results."""
    return (course_folder() / "data").resolve()


def sums() -> dict[str, str]:
    """Returns the expected SHA-256 of each file listed in `data/SHA256SUMS`, by name."""
    path = data_folder() / SUMS
    lines = path.read_text(encoding="utf-8").splitlines() if path.is_file() else []
    return {name: digest for digest, _, name in (line.partition("  ") for line in lines)}


def measured_sums() -> dict[str, str]:
    """Returns the actual SHA-256 of all files in `data/` but results, texts and hidden files."""
    without = re.compile(r"results/.*|.*\.md|(.*/)?\..*|" + SUMS)
    found = sorted(_data_files().items())
    return {name: _sha256(path) for name, path in found if not without.fullmatch(name)}


def write_sums() -> Path:
    """Rewrites `data/SHA256SUMS` from the current files and returns its path."""
    path = data_folder() / SUMS
    text = "".join(f"{digest}  {name}\n" for name, digest in measured_sums().items())
    write_text(path, text)
    return path


def remedy(name: str, folder: str = "data") -> str:
    """Returns the shell command that restores a file of `data/`, or of another folder.

    It is for the folder of a checkout.
    """
    return f"git checkout -- {folder}/{name}"


def _data_files() -> dict[str, Path]:
    folder = data_folder()
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path for path in files}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def not_found(kind: str, name: str, available: list[str], *, wanted: str | None = None) -> str:
    """The sentence about a name that does not exist: which are close to it, and which there are.

    Args:
        kind: What the name is of: "notebook", "exercise".
        name: The name that was given.
        available: All names.
        wanted: The part of the name to compare with them; all of it if None.
    """
    lines = [f"there is no {kind} {name!r}"]
    near = difflib.get_close_matches(wanted or name, available, n=3, cutoff=0.5)
    if near:
        return f"{lines[0]}; did you mean: {', '.join(near)}?"
    lines.append(f"available: {', '.join(available)}" if available else "none are installed")
    return "; ".join(lines)
