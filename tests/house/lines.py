"""Prints the lines of code of each folder, without docstrings and comments: `make lines`."""

import ast
import io
import tokenize
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOPS = ("course.py", "release.py", "cotlearn", "notebooks", "benchmarks", "docs", "tests")

_NOTHING = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
}


def code_lines(path: Path) -> int:
    """Lines of a Python file that hold code."""
    text = path.read_text("utf-8")
    found: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NOTHING:
            found.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        if isinstance(node, documented) and ast.get_docstring(node) is not None:
            first = node.body[0]
            found -= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(found)


def counted() -> Counter[str]:
    """Lines of code of every folder, two levels deep, and of every module beside these."""
    found: Counter[str] = Counter()
    for top in TOPS:
        for path in [ROOT / top, *(ROOT / top).rglob("*.py")]:
            if path.suffix == ".py":
                found["/".join(path.relative_to(ROOT).parts[:2])] += code_lines(path)
    return found


if __name__ == "__main__":
    folders = counted()
    for name, lines in sorted(folders.items()):
        print(f"{lines:6d} {name}")
    for top in TOPS:
        print(f"{sum(n for name, n in folders.items() if name.split('/')[0] == top):6d} {top}")
