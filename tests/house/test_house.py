"""The house stays small: lines of code, lengths of files, and nothing that only tests use."""

from lines import code_lines, count
from unused import ROOT, unused

MOST = {"cotlearn": 12_700, "tests": 14_000}  #: lines of code
LONGEST = 400  #: lines of a file of `cotlearn`, all of them

EXAMPLE = '''"""A module.

More of it."""

# why
x = 1  # what


def f():
    """A function."""
    return x
'''


def test_code_lines_are_counted_without_docstrings_comments_and_blanks(tmp_path):
    path = tmp_path / "example.py"
    path.write_text(EXAMPLE)
    assert code_lines(path) == 3


def test_the_house_is_small():
    for folder, most in MOST.items():
        assert sum(count(ROOT / folder).values()) <= most, folder


def test_no_file_is_long():
    sizes = {p: len(p.read_text("utf-8").splitlines()) for p in (ROOT / "cotlearn").rglob("*.py")}
    assert not {str(path): size for path, size in sizes.items() if size > LONGEST}


def test_every_public_name_and_option_is_used():
    assert not unused()
