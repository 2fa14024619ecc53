"""What files say to strangers: how to install, and nothing of the machine that wrote them."""

import re
import subprocess
import tomllib

import pytest
from lines import ROOT

from cotlearn.extras import how_to_install

SUFFIXES = {".py", ".md", ".ipynb", ".json", ".csv", ".html", ".toml", ".yml", ".cff", ""}


def texts():
    """All texts in the repository, with their names."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this is no repository")
    for name in listed.stdout.splitlines():
        path = ROOT / name
        if path.suffix in SUFFIXES and path.is_file():
            yield name, path.read_text("utf-8")


def test_nothing_is_installed_by_its_bare_name():
    """In a registry the name may be somebody else's."""
    bare = re.compile(r"pip install (?:-[\w-]+ )*[\"']?cotlearn(?![\w-])(?!\[[^]]*\] @)")
    assert [name for name, text in texts() if bare.search(text)] == []


def test_no_text_names_a_folder_of_the_machine_that_wrote_it():
    folder = re.compile(r"(?<![\w.~*>/])/(?:work|root|home/\w+|Users/\w+|tmp/\w+)/\w")
    assert folder.search('"cwd": "/' + 'home/somebody/course"')
    assert [(name, *folder.findall(text)) for name, text in texts() if folder.search(text)] == []


def test_every_extra_that_is_named_exists():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {
        extra
        for _, text in texts()
        for some in re.findall(r"(?:how_to_install\(['\"]|pip install (?:-e )?'\.\[)([\w,]+)", text)
        for extra in some.split(",")
    }
    assert {"course", "formats", "instructor", "peers"} <= named
    assert named <= set(extras["optional-dependencies"])
    assert how_to_install("course").startswith("pip install '.[course]'")
