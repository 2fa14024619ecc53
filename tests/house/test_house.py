"""The house stays small: nothing is public that only tests use."""

import json
import re
import subprocess
import sys

import pytest
from lines import ROOT, code_lines

from cotlearn.robots.registry import TASKS

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


def blocks():
    """The Python of all notebooks and pages."""
    for path in sorted((ROOT / "notebooks").rglob("*.ipynb")):
        for cell in json.loads(path.read_text("utf-8"))["cells"]:
            text = "".join(cell["source"])
            yield re.sub(r"^\s*[%!].*", "", text, flags=re.M) if cell["cell_type"] == "code" else ""
    for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        yield from re.findall(r"^```python[^\n]*\n(.*?)^```", path.read_text("utf-8"), re.M | re.S)


@pytest.mark.slow
def test_every_public_name_is_used_by_more_than_tests(tmp_path):
    """What Jupyter calls is named in pyproject.toml, and what gymnasium calls by the tasks."""
    for number, block in enumerate(blocks()):
        (tmp_path / f"block_{number}.py").write_text(block)
    names = [task.entry_point.rpartition(":")[2] for task in TASKS.values()]
    (tmp_path / "environments.py").write_text("\n".join(names))
    readers = ["cotlearn", "notebooks", "benchmarks", "docs", "course.py", "release.py"]
    command = [sys.executable, "-m", "vulture", *readers, str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 3), done.stderr  # 3: it found something
    unused = re.findall(
        r"^cotlearn.* unused (?:function|method|class|property) .*", done.stdout, re.M
    )
    assert not unused, "\n".join(unused)
