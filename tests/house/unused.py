"""Which public names and options of `cotlearn` nobody uses but the tests.

Whoever reads counts as a user: the package itself, notebooks, homework, the pages of `docs`, the
README, benchmarks and scripts. What is found is a suspicion by name: a use of any function called
`fit` counts for all of them.
"""

import ast
import json
import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
READERS = ("cotlearn", "notebooks", "docs", "benchmarks", "release", "README.md", "course.py")
#: Called by torch, gymnasium, pytest or the standard library.
PROTOCOL = {"forward", "reset", "step", "render", "close"}
PROTOCOL |= {"find_spec", "create_module", "exec_module"}
#: What is random can be repeated by whoever wants to.
RANDOMNESS = {"seed", "generator"}
#: What files that were saved before may hold.
STORED = {("DDPMSampler", "levels")}
#: Typer's functions are called with what is typed.
COMMANDS = ROOT / "cotlearn" / "cli"
_FENCED = r"```(?:\{code-cell\}|python)[^\n]*\n(.*?)```"
_BLOCK = re.compile(rf"{_FENCED}|((?:^    [^\n]*\n+)+)", re.S | re.M)

Option = tuple[str, str]  #: name of a function, class or method, and of its argument


@dataclass
class Uses:
    """What readers mention.

    Attributes:
        names: identifiers, each with the number of its mentions but definitions and exports.
        options: option -> the options of the caller that it only hands on; None: a real use.
        anything: functions that somebody calls with `**options`.
    """

    names: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    options: dict[Option, list[Option | None]] = field(default_factory=lambda: defaultdict(list))
    positions: dict[str, int] = field(default_factory=lambda: defaultdict(int))
    anything: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Definition:
    """A public function, class or method: where it is, and its options with their positions."""

    where: str
    name: str
    options: dict[str, int]
    bases: tuple[str, ...] = ()


def sources() -> Iterator[tuple[Path, str]]:
    """Python code of all readers."""
    for name in READERS:
        top = ROOT / name
        for path in sorted(top.rglob("*")) if top.is_dir() else [top]:
            if path.suffix == ".py":
                yield path, path.read_text("utf-8")
            elif path.suffix == ".ipynb":
                for cell in json.loads(path.read_text("utf-8"))["cells"]:
                    text = "".join(cell["source"])
                    code = [x for x in text.splitlines() if not x.lstrip().startswith(("%", "!"))]
                    is_code = cell["cell_type"] == "code"
                    yield from (
                        (path, b) for b in (["\n".join(code)] if is_code else _blocks(text))
                    )
            elif path.suffix == ".md":
                yield from ((path, block) for block in _blocks(path.read_text("utf-8")))


def _blocks(text: str) -> Iterator[str]:
    for fenced, indented in _BLOCK.findall(text):
        yield fenced or re.sub(r"^    ", "", indented, flags=re.M)


def uses() -> Uses:
    """What all readers mention."""
    found = Uses()
    for path, code in sources():
        try:
            tree = ast.parse(code)
        except SyntaxError:  # a command line, or a sketch
            continue
        _Reader(found, path).visit(tree)
    return found


class _Reader(ast.NodeVisitor):
    def __init__(self, found: Uses, path: Path) -> None:
        self.found, self.is_package = found, path.name == "__init__.py"
        self.typed = COMMANDS in path.parents  # options come from the command line
        self.around: list[tuple[str, set[str]]] = []

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        owner = node.name
        if node.name == "__init__" and self.around:
            owner = self.around[-1][0]
        if node.decorator_list and not _is_plain(node.decorator_list):
            self.found.names[node.name] += 1  # somebody registers it
        self.around.append((owner, set(_options(node.args, 0))))
        self.generic_visit(node)
        self.around.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.around.append((node.name, set()))
        self.generic_visit(node)
        self.around.pop()

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load):
            self.found.names[node.id] += 1

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self.found.names[node.attr] += 1
        self.generic_visit(node)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        if not self.is_package:
            for alias in node.names:
                self.found.names[alias.name] += 1

    def visit_Constant(self, node: ast.Constant) -> None:
        text = node.value.rpartition(":")[2] if isinstance(node.value, str) else ""
        if text.isidentifier() and not self.is_package:
            self.found.names[text] += 1  # getattr, a table of names, an entry point

    def visit_Dict(self, node: ast.Dict) -> None:
        for key, value in zip(node.keys, node.values, strict=True):
            if isinstance(key, ast.Constant) and isinstance(key.value, str):  # **options, later
                self.found.options["replace", key.value].append(self._handed_on(value))
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = _called(node.func)
        arguments = node.args
        if name == "partial" and arguments:
            name, arguments = _called(arguments[0]), arguments[1:]
        if name in {"cls", "super", "__init__"} and self.around:
            name = self.around[0][0]
        if name:
            self.found.positions[name] = max(self.found.positions[name], len(arguments))
            for keyword in node.keywords:
                if keyword.arg is None:
                    self.found.anything.add(name)
                else:
                    self.found.options[name, keyword.arg].append(self._handed_on(keyword.value))
            if any(isinstance(a, ast.Starred) for a in arguments):
                self.found.positions[name] = 99
        self.generic_visit(node)

    def _handed_on(self, value: ast.expr) -> Option | None:
        if isinstance(value, ast.Name) and not self.typed:
            for owner, options in reversed(self.around):
                if value.id in options:
                    return owner, value.id
        return None


def _is_plain(decorators: list[ast.expr]) -> bool:
    plain = {"property", "classmethod", "staticmethod", "cached_property", "cache", "lru_cache"}
    plain |= {"njit", "no_grad", "contextmanager", "dataclass", "abstractmethod", "overload"}
    return all(_called(d.func if isinstance(d, ast.Call) else d) in plain for d in decorators)


def _called(function: ast.expr) -> str:
    if isinstance(function, ast.Name):
        return function.id
    if isinstance(function, ast.Attribute):
        return function.attr
    return ""


def _options(arguments: ast.arguments, skip: int) -> dict[str, int]:
    """Arguments with a default -> position in a call, 99 for keywords only."""
    every = [*arguments.posonlyargs, *arguments.args][skip:]
    first = len(every) - len(arguments.defaults)
    found = {a.arg: i for i, a in enumerate(every) if i >= first}
    given = zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True)
    return found | {a.arg: 98 for a, default in given if default is not None}


def definitions(folder: Path = ROOT / "cotlearn") -> Iterator[Definition]:
    """All public functions, classes and methods."""
    for path in sorted(folder.rglob("*.py")):
        if COMMANDS in path.parents or path.name.startswith("__main__"):
            continue
        where = str(path.relative_to(ROOT))
        for node in ast.parse(path.read_text("utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name[0] != "_":
                registered = bool(node.decorator_list) and not _is_plain(node.decorator_list)
                options = {} if registered else _options(node.args, 0)
                yield Definition(where, node.name, options)
            elif isinstance(node, ast.ClassDef) and node.name[0] != "_":
                yield from _class(where, node)


def _class(where: str, node: ast.ClassDef) -> Iterator[Definition]:
    bases = tuple(_called(base) for base in node.bases)
    if "Protocol" in bases:
        return
    fields = [s for s in node.body if isinstance(s, ast.AnnAssign)]
    record = "NamedTuple" in bases or any(
        _called(d.func if isinstance(d, ast.Call) else d) == "dataclass"
        for d in node.decorator_list
    )
    options = {
        s.target.id: i
        for i, s in enumerate(fields)
        if isinstance(s.target, ast.Name) and s.value is not None and s.target.id[0] != "_"
    }
    options = options if record else {}
    for method in node.body:
        if isinstance(method, ast.FunctionDef):
            if method.name == "__init__":
                options |= _options(method.args, 1)
            elif method.name[0] != "_" and method.name not in PROTOCOL:
                is_property = any(_called(d) == "property" for d in method.decorator_list)
                skip = 0 if any(_called(d) == "staticmethod" for d in method.decorator_list) else 1
                own = {} if is_property else _options(method.args, skip)
                yield Definition(where, method.name, own)
    yield Definition(where, node.name, options, bases)


def unused() -> list[str]:
    """`file: name` and `file: name(option)` of all that only tests use."""
    found, listed = uses(), list(definitions())
    children: dict[str, set[str]] = defaultdict(set)
    for definition in listed:
        for base in definition.bases:
            children[base].add(definition.name)
    real: set[Option] = set()
    while True:
        more = {
            option
            for option, handed in found.options.items()
            if option not in real and any(h is None or h in real for h in handed)
        }
        if not more:
            break
        real |= more
    replaced = {option for name, option in real if name in {"replace", "_replace", "make"}}
    result = []
    for d in listed:
        if not found.names[d.name]:
            result.append(f"{d.where}: {d.name}")
            continue
        names = {d.name} | children[d.name]
        for child in list(children[d.name]):
            names |= children[child]
        for option, position in d.options.items():
            if option in RANDOMNESS or (d.name, option) in STORED:
                continue
            known = any((name, option) in real for name in names) or option in replaced
            by_place = any(found.positions[name] > position for name in names)
            if not (known or by_place or names & found.anything):
                result.append(f"{d.where}: {d.name}({option})")
    return result


if __name__ == "__main__":
    start = sys.argv[1] if len(sys.argv) > 1 else ""
    print("\n".join(line for line in unused() if line.startswith(start)))
