"""Counts lines of code, without docstrings, comments and blanks.

Usage: python tests/house/lines.py cotlearn tests
"""

import ast
import io
import sys
import tokenize
from pathlib import Path

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


def count(folder: Path) -> dict[Path, int]:
    """Lines of code of every Python file in a folder."""
    return {path: code_lines(path) for path in sorted(folder.rglob("*.py"))}


if __name__ == "__main__":
    for name in sys.argv[1:] or ["cotlearn", "tests"]:
        lines = count(Path(name))
        for path, number in lines.items():
            print(f"{number:6d} {path}")
        print(f"{sum(lines.values()):6d} {name}, {len(lines)} files")
