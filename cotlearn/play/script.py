"""Joins ES modules into one script, because browsers import none from a disk.

Each module becomes a function that is called once and returns what the module exports; an import
becomes the names taken from that. The modules keep to two forms: `import { a, b } from "./c.js";`
and `export` before a function, a class or a constant.
"""

import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
_IMPORT = re.compile(r'^import \{([^}]+)\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE)


def joined(*modules: str) -> str:
    """One script that leaves an object `cotlearn_play` with each module under its name.

    Args:
        modules: names of files without ".js"; what they import is found.

    Raises:
        ValueError: a module has an import or export of another form.
    """
    parts = {}
    for name in _in_order(modules):
        text = (FOLDER / f"{name}.js").read_text("utf-8")
        names = [match[2] for match in _EXPORT.finditer(text)]
        body = _EXPORT.sub(r"\1", _IMPORT.sub(_taken, text))
        left = re.search(r"^(?:import|export)\b.*", body, re.MULTILINE)
        if left:
            raise ValueError(f"{name}.js must not have this form: {left[0]}")
        parts[name] = (
            f"const {name}_js = (() => {{\n{body}return {{ {', '.join(names)} }};\n}})();\n"
        )
    whole = "".join(parts.values())
    exported = ", ".join(f"{name}: {name}_js" for name in parts)
    return f"const cotlearn_play = (() => {{\n{whole}return {{ {exported} }};\n}})();\n"


def style_sheet() -> str:
    """The panels' CSS."""
    return (FOLDER / "play.css").read_text("utf-8")


def _in_order(modules: tuple[str, ...]) -> list[str]:
    """All modules, each after those that it imports."""
    found: dict[str, None] = {}

    def visit(name: str) -> None:
        if name not in found:
            text = (FOLDER / f"{name}.js").read_text("utf-8")
            for match in _IMPORT.finditer(text):
                visit(match[2])
            found[name] = None

    for name in modules:
        visit(name)
    return list(found)


def _taken(match: re.Match[str]) -> str:
    """`const { a, b: c } = module_js;` for `import { a, b as c } from "./module.js";`."""
    names = re.sub(r"(\w+) as (\w+)", r"\1: \2", match[1])
    return f"const {{{names}}} = {match[2]}_js;\n"
