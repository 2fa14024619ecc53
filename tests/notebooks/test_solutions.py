"""Every folded solution is right, every unchanged stub counts as not attempted."""

import ast
import re

import matplotlib as mpl
import pytest

from cotlearn.course import check
from cotlearn.course.checking import Verdict

PREAMBLE = "import math, torch, numpy as np, matplotlib.pyplot as plt, cotlearn"
SOLUTION = re.compile(r"<summary>Solution</summary>(.*?)</details>", re.DOTALL)
FENCED = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def exercises(cells):
    """Yields (stub, source of its check cell, solution)."""
    for i, cell in enumerate(cells):
        if "exercise" in cell.metadata.get("tags", []):
            folded = SOLUTION.search(cells[i + 2].source)
            assert folded, f"cell {i + 2} holds no solution"
            solution = "\n".join(FENCED.findall(folded[1]))
            yield cell.source, cells[i + 1].source, solution


def checks(source):
    """Finds the calls check(answer, "name") in a cell."""
    calls = [
        (ast.unparse(node.args[0]), ast.literal_eval(node.args[1]))
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "check"
    ]
    assert calls, "the check cell calls no check"
    return calls


def verdicts(source, checking):
    namespace = {"__name__": "__main__"}
    with mpl.rc_context({"backend": "agg"}):
        exec(PREAMBLE, namespace)
        exec(compile(source, "<cell>", "exec"), namespace)
        return [check(eval(answer, namespace), name) for answer, name in checks(checking)]


def said(cells, source, checking, capsys):
    """What the check of an extra prints: it is written out there, and needs but the imports."""
    imports = next(cell.source for cell in cells if cell.cell_type == "code")
    namespace = {"__name__": "__main__"}
    with mpl.rc_context({"backend": "agg"}):
        exec("\n".join([imports, source, checking]), namespace)
    return capsys.readouterr().out.splitlines()[-1]


@pytest.mark.parametrize(
    ("which", "verdict", "words"),
    [(2, Verdict.CORRECT, "✓ correct"), (0, Verdict.NOT_ATTEMPTED, "not attempted yet")],
    ids=["solution", "stub"],
)
def test_what_is_said_of(cells, extra, capsys, which, verdict, words):
    for exercise in exercises(cells):
        source, checking = exercise[which], exercise[1]
        if extra:
            assert said(cells, source, checking, capsys) == words
            continue
        found = verdicts(source, checking)
        assert set(found) == {verdict}, f"{checking}: {capsys.readouterr().out}"


def test_each_check_belongs_to_its_notebook(cells, path, extra):
    if extra:
        return
    names = [name for _, checking, _ in exercises(cells) for _, name in checks(checking)]
    assert len(names) == len(set(names))
    assert {name.split(".")[0] for name in names} == {path.name[:2]}
