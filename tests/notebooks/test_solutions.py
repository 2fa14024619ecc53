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
    """What the check of an extra prints: it needs but the imports."""
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
            assert said(cells, source, checking, capsys).partition(":")[0] == words
            continue
        found = verdicts(source, checking)
        assert set(found) == {verdict}, f"{checking}: {capsys.readouterr().out}"


ANSWER = 6  #: names, numbers, calls and operators that make an expression an answer
COUNTED = (ast.Name, ast.Constant, ast.Call, ast.BinOp, ast.Subscript, ast.Attribute)
MODULES = {"math", "np", "torch"}


def expressions(source, whole=False):
    """The larger expressions of a cell, whichever object a method is called on.

    If `whole`, only those that are returned or get a name.
    """
    tree = ast.parse(re.sub(r"^\s*[%!].*", "", source, flags=re.M))
    for node in (n for n in ast.walk(tree) if isinstance(n, ast.Call)):
        owner = getattr(node.func, "value", None)  # petals() in petals().sample(n)
        named = owner.func if isinstance(owner, ast.Call) and not owner.args else owner
        if isinstance(named, ast.Name) and named.id not in MODULES:
            node.func.value = ast.Name("_")
    nodes = list(ast.walk(tree))
    if whole:
        nodes = [n.value for n in nodes if isinstance(n, ast.Return | ast.Assign)]
    sized = ((n, sum(isinstance(part, COUNTED) for part in ast.walk(n))) for n in nodes if n)
    return {ast.dump(n) for n, size in sized if isinstance(n, ast.expr) and size >= ANSWER}


def test_no_code_in_sight_below_an_exercise_is_its_answer(cells):
    for i, cell in enumerate(cells):
        if "exercise" not in cell.metadata.get("tags", []):
            continue
        answers = expressions("\n".join(FENCED.findall(cells[i + 2].source)), whole=True)
        for below in cells[i + 3 :]:
            if below.cell_type == "code" and not below.metadata.get("jupyter"):
                told = answers & expressions(below.source)
                assert not told, f"fold this cell, it has the answer {told}:\n{below.source}"


def test_each_check_belongs_to_its_notebook(cells, path, extra):
    if extra:
        return
    names = [name for _, checking, _ in exercises(cells) for _, name in checks(checking)]
    assert len(names) == len(set(names))
    assert {name.split(".")[0] for name in names} == {path.name[:2]}
