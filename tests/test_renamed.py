"""Old names work for one minor version, and say what they are called now."""

import ast
import importlib
import inspect
import json
import warnings
from pathlib import Path

import pytest

from cotlearn.renamed import MODULES, renamed


@pytest.mark.parametrize("old", MODULES)
def test_a_module_that_moved_is_found_with_a_warning(old, monkeypatch):
    monkeypatch.delitem(importlib.sys.modules, old, raising=False)
    new = importlib.import_module(MODULES[old])
    spec = new.__spec__
    with pytest.warns(FutureWarning, match=f"{old} is called {MODULES[old]} now"):
        assert importlib.import_module(old) is new
    assert new.__spec__ is spec


def test_a_name_that_changed_is_found_with_a_warning():
    find = renamed("cotlearn.metrics", {"old": "energy_score", "far": "cotlearn.claims:claim"})
    with pytest.warns(FutureWarning, match="metrics.old is called cotlearn.metrics.energy_score"):
        assert find("old") is importlib.import_module("cotlearn.metrics").energy_score
    with pytest.warns(FutureWarning, match="metrics.far is called cotlearn.claims.claim now"):
        assert find("far") is importlib.import_module("cotlearn.claims").claim


def test_other_names_are_unknown():
    with pytest.raises(AttributeError, match="has no attribute 'never'"):
        renamed("cotlearn.metrics", {})("never")


FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(path for path in FOLDER.rglob("*.ipynb") if "/." not in path.as_posix())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_notebook_uses_an_old_name(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = "".join("".join(c["source"]) + "\n" for c in cells if c["cell_type"] == "code")
    plain = "\n".join(x for x in code.splitlines() if not x.lstrip().startswith(("!", "%")))
    nodes, names = list(ast.walk(ast.parse(plain))), {}
    with warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        for node in nodes:
            if isinstance(node, ast.Import | ast.ImportFrom):
                exec(ast.unparse(node), names)
        for node in nodes:
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                owner = names.get(node.value.id)
                assert not inspect.ismodule(owner) or hasattr(owner, node.attr), ast.unparse(node)
