"""Every Python block of the documentation runs.

A word after ```python names a package of the extra `peers` that the block needs. A block may use
what the blocks before it on its page have defined, but for those with such a word.
"""

import re
from functools import cache
from pathlib import Path

import pytest
from peers import peer

pytestmark = pytest.mark.slow
DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```python *(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@cache
def blocks_of(page):
    return BLOCK.findall(page.read_text("utf-8"))


def blocks():
    for page in sorted(DOCS.rglob("*.md")):
        for number in range(len(blocks_of(page))):
            yield pytest.param(page, number, id=f"{page.stem}-{number + 1}")


@cache
def names_after(page, number):
    """Run the first blocks of a page that need nothing; return the names that they define."""
    if number == 0:
        return {}
    names = dict(names_after(page, number - 1))
    needs, code = blocks_of(page)[number - 1]
    if not needs:
        exec(compile(code, f"{page.stem}, block {number}", "exec"), names)
    return names


def test_there_are_blocks():
    assert len(list(blocks())) >= 8


@pytest.fixture
def torchrun(monkeypatch):
    """What torchrun tells a process that is alone."""
    told = {"RANK": "0", "WORLD_SIZE": "1", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": "0"}
    for name, value in told.items():
        monkeypatch.setenv(name, value)


@pytest.mark.usefixtures("two_candidates", "torchrun")
@pytest.mark.parametrize(("page", "number"), list(blocks()))
def test_block_runs(page, number):
    needs, code = blocks_of(page)[number]
    if needs:
        peer(needs)
        names = dict(names_after(page, number))
        exec(compile(code, f"{page.stem}, block {number + 1}", "exec"), names)
    else:
        names_after(page, number + 1)
