"""Every Python block of the documentation runs."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```python *(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks():
    for page in sorted(DOCS.glob("*.md")):
        for number, (needs, code) in enumerate(BLOCK.findall(page.read_text("utf-8")), start=1):
            yield pytest.param(needs, code, id=f"{page.stem}-{number}")


def test_there_are_blocks():
    assert len(list(blocks())) >= 4


@pytest.mark.parametrize(("needs", "code"), list(blocks()))
def test_block_runs(needs, code):
    if needs:
        pytest.importorskip(needs, reason=f"{needs} is not installed")
    exec(compile(code, "<documentation>", "exec"), {})
