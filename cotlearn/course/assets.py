"""Finds the notebooks and data of the course by name, in a checkout or an installed wheel.

A data file is checked against its SHA-256 sum in `data/SHA256SUMS` when it is looked up. After a
change of the data, `python -m cotlearn.course` rewrites `data/SHA256SUMS`.
"""

import difflib
import hashlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from cotlearn.extras import REINSTALL
from cotlearn.files import write_text

#: In the folder `data/`: one line per file, in the format of the program `sha256sum`.
SUMS = "SHA256SUMS"
#: Folders of notebooks beside the path: what a lesson leaves out, and related work.
ROOMS = ("laboratory", "extras")

_PACKAGE = Path(__file__).resolve().parents[1]
#: A link or picture in a notebook, to a file.
_LINK = re.compile(
    r"(?P<image>!?)\[(?P<words>[^\]]*)\]\((?P<file>[^\s():#]+\.(?:ipynb|md|svg|png))(?P<part>#[^\s()]*)?\)"
)
_NUMBERED = re.compile(r"\d\d_.*\.ipynb")


def checkout() -> Path | None:
    """Returns the root of the checkout that this package is imported from, or None in a wheel."""
    root = _PACKAGE.parent
    found = (root / "pyproject.toml").is_file() and (root / "course.py").is_file()
    return root if found else None


def course_folder() -> Path:
    """Returns the folder that holds `notebooks/` and `data/`."""
    return checkout() or _PACKAGE / "_course"


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

    Both are for the folder of a checkout.
    """
    if checkout() is not None:
        return f"git checkout -- {folder}/{name}"
    return REINSTALL


def _data_files() -> dict[str, Path]:
    folder = data_folder()
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path for path in files}


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def copy_notebooks(folder: Path) -> tuple[list[Path], list[Path]]:
    """Copies all notebooks into `folder` without overwriting existing files.

    Homework goes beside the notebooks of the path, side rooms into folders of their names.

    Args:
        folder: The destination; created if it does not exist.

    Returns:
        The paths that were copied, and the existing paths that were kept.

    Raises:
        ValueError: If `folder` is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder must be a directory, got the file {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    given_out = course_folder() / "notebooks" / "homework"
    homework = [
        *sorted((given_out / "student").glob("*.ipynb")),
        *given_out.glob("challenge.ipynb"),
    ]
    copied, kept = [], []
    places = {source: folder / source.name for source in [*notebooks(), *homework]}
    places |= {source: folder / room / source.name for room in ROOMS for source in notebooks(room)}
    places = {source.resolve(): target for source, target in places.items()}
    for source, target in places.items():
        target.parent.mkdir(exist_ok=True)
        if target.exists():
            kept.append(target)
        else:
            copy_notebook(source, target, places)
            copied.append(target)
    return copied, kept


def copy_notebook(source: Path, target: Path, places: Mapping[Path, Path]) -> None:
    """Copies a notebook; its links lead to the copies, and where there is none become words.

    Args:
        source: The notebook.
        target: The copy.
        places: Every file that is copied -> its copy.
    """
    notebook = json.loads(source.read_text(encoding="utf-8"))

    def moved(link: re.Match[str]) -> str:
        there = (source.parent / link["file"]).resolve()
        if there in places:
            found = os.path.relpath(places[there], target.parent)
            return f"[{link['words']}]({Path(found).as_posix()}{link['part'] or ''})"
        name = Path(os.path.relpath(there, course_folder().resolve())).as_posix()
        return (
            f"*{link['words']}*" if link["image"] else f"{link['words']} (`{name}` in a checkout)"
        )

    for cell in notebook.get("cells", []):
        if cell["cell_type"] == "markdown":
            text = _LINK.sub(moved, "".join(cell["source"]))
            cell["source"] = text.splitlines(keepends=True)
    write_text(target, json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")


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
        lines.append(f"did you mean: {', '.join(near)}?")
    lines.append(f"available: {', '.join(available)}" if available else "none are installed")
    return "; ".join(lines)
