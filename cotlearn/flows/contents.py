"""What a coupling, a loss or a network holds, in few digits: numbers, tensors, functions, code.

A repr tells the options of a coupling, but not the noise of its fixed pairs, the weights of its
teacher, or what a function or a class of a user computes. A training must not go on with others.
"""

import argparse
import contextlib
import dataclasses
import functools
import hashlib
import inspect
import sys
import types
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from cotlearn.couplings.base import Coupling, content_of

DIGITS = 16
#: Packages whose code is not a user's: of their functions and classes the name counts.
KNOWN = {*sys.stdlib_module_names, "cotlearn", "numpy", "torch"}
GENERATED = "<string>"  #: where the methods that a dataclass gets have their code
OPTIMISED = "_orig_mod"  #: where `torch.compile` keeps the module
PLAIN = (type(None), bool, int, float, complex, str, bytes)
FUNCTIONS = (types.FunctionType, types.BuiltinFunctionType, functools.partial)
COLLECTIONS = (Mapping, list, tuple, set, frozenset, types.SimpleNamespace, argparse.Namespace)
OF_EVERY_MODULE = {*vars(nn.Module())}  #: attributes of any module, which are no settings
OF_COMPILING = "compile", "dynamo"  #: in the names of what `torch.compile` leaves in a module
INSTALLED = {"site-packages", "dist-packages"}  #: folders of packages
HELD = (*PLAIN, *FUNCTIONS, Tensor, np.ndarray, nn.Module)


def contents(part: Any) -> str:
    """A digest of everything that a part holds: the same in another process, and after a resume.

    Of a dataclass it reads the fields, of a network all settings, of another object the attributes
    without a leading underscore; of a user's functions and classes the text, where Python has it,
    and what they use of the user's own modules. So a coupling that counts its calls should call the
    counter `_calls`, and a loss the list of what it has seen `_seen`.
    """
    reader = _Reader()
    reader.read(part)
    return reader.found.hexdigest()[:DIGITS]


class _Reader:
    def __init__(self) -> None:
        self.found = hashlib.sha256()
        self.seen: dict[int, Any] = {}  # keeps what was read, so that no address is used again

    def say(self, text: str) -> None:
        self.found.update(f"{text};".encode())

    def read(self, value: Any) -> None:
        """Add a value and all it holds to the digest."""
        if isinstance(value, PLAIN):
            self.say(f"{type(value).__name__} {value!r}")
        elif isinstance(value, Tensor):
            self.found.update(content_of(value))
        elif isinstance(value, np.ndarray | np.generic):
            self.say(f"{value.dtype} {value.shape}")
            self.found.update(np.ascontiguousarray(value).tobytes())
        elif id(value) not in self.seen:
            self.seen[id(value)] = value
            self._read_parts(value)

    def _read_parts(self, value: Any) -> None:
        if isinstance(value, Mapping):
            for name, item in value.items():
                self.say(str(name))
                self.read(item)
        elif isinstance(value, list | tuple):
            self.say(str(len(value)))
            for item in value:
                self.read(item)
        elif isinstance(value, set | frozenset):
            self.read(sorted(map(repr, value)))
        elif isinstance(value, functools.partial):
            self.read([value.func, value.args, value.keywords])
        elif inspect.ismethod(value):
            self.read([value.__self__, value.__func__])
        elif inspect.isfunction(value):
            self._read_function(value)
        elif inspect.isbuiltin(value):
            self.say(value.__qualname__)
        elif isinstance(value, type):
            self.say(value.__name__)
            if _is_own(value):
                self._read_methods(value)
        elif "__qualname__" in getattr(value, "__dict__", {}):
            self.say(value.__qualname__)  # it goes by that name
        else:
            self._read_object(value)

    def _read_function(self, function: Any) -> None:
        self.say(function.__qualname__)
        self.read(inspect.getclosurevars(function).nonlocals)
        if _is_users(function):
            self.read([function.__defaults__, function.__kwdefaults__])
            self._read_source(function)
            self.read(_used(_names(function.__code__), function.__globals__))

    def _read_source(self, function: Any) -> None:
        """The text of a function: unlike its byte code it is the same for another Python."""
        with contextlib.suppress(OSError, TypeError):  # typed in without a file: it has a name only
            self.say(inspect.getsource(function))
        ends = [end for *_, end in function.__code__.co_positions() if end is not None]
        self.say(str(max(ends, default=0)))  # tells two lambdas of one line apart

    def _read_object(self, value: Any) -> None:
        if isinstance(value, nn.Module):
            self._read_network(value)
            return
        self.say(type(value).__qualname__)
        self._read_methods(type(value))
        self.read({k: f for k, f in _attributes(value).items() if inspect.isfunction(f)})
        self.read(_options(value))
        fitted = getattr(value, "state_dict", None)
        if fitted and not isinstance(value, Coupling) and not getattr(value, "fitted_to", b""):
            self.read(fitted())

    def _read_network(self, network: Any) -> None:
        """The tensors of a network, then the code and the settings of its modules."""
        network = getattr(network, OPTIMISED, network)
        state = network.state_dict()
        self.read({name.replace(f"{OPTIMISED}.", ""): value for name, value in state.items()})
        for module in network.modules():
            if hasattr(module, OPTIMISED):
                continue  # it comes next
            kind = type(module)
            self.say(kind.__qualname__)
            self.read({name: value for name, value in vars(module).items() if _is_set(name, value)})
            if _is_users(kind):
                self._read_methods(kind)
                self.read({k: v for k, v in _attributes(module).items() if k != "training"})
            else:
                self.say(module.extra_repr())

    def _read_methods(self, kind: type) -> None:
        """The functions and constants of a user's class, and of those that it inherits from."""
        for owner in filter(_is_users, kind.__mro__):
            for name, value in vars(owner).items():
                function = getattr(value, "fget", getattr(value, "__func__", value))
                if inspect.isfunction(function):
                    if function.__code__.co_filename != GENERATED:
                        self.say(name)
                        self.read(function)
                elif not name.startswith("__") and isinstance(
                    value, (*PLAIN, Tensor, *COLLECTIONS)
                ):
                    self.say(name)
                    self.read(value)


def _is_users(part: Any) -> bool:
    """Whether a function or a class is neither of this package nor of Python, NumPy or torch."""
    return str(part.__module__).partition(".")[0] not in KNOWN


def _is_own(part: Any) -> bool:
    """Whether a module or a class lies in a user's file, not in an installed package."""
    module = part if isinstance(part, types.ModuleType) else sys.modules.get(part.__module__)
    if module is None or module.__name__.partition(".")[0] in KNOWN:
        return False
    file = getattr(module, "__file__", None) or ""  # a notebook has none
    return not INSTALLED.intersection(Path(file).parts)


def _is_set(name: str, value: Any) -> bool:
    """Whether an attribute of a network, also a hidden one, is a setting: it computes by it."""
    if name in OF_EVERY_MODULE or any(word in name for word in OF_COMPILING):
        return False
    return isinstance(value, (*PLAIN, *FUNCTIONS)) or (
        isinstance(value, list | tuple) and all(isinstance(item, PLAIN) for item in value)
    )


def _names(code: types.CodeType) -> set[str]:
    """The globals and attributes that a function uses, also inside of others."""
    inner = (const for const in code.co_consts if isinstance(const, types.CodeType))
    return {*code.co_names}.union(*map(_names, inner))


def _used(names: set[str], space: Mapping[str, Any], seen: tuple[Any, ...] = ()) -> dict[str, Any]:
    """What of a module's names counts; of a user's own module, what counts of its names."""
    found = {}
    for name in sorted(names & space.keys()):
        value = space[name]
        if isinstance(value, types.ModuleType):
            if _is_own(value) and not any(value is module for module in seen):
                found[name] = _used(names, vars(value), (*seen, value))
        elif _counts(value):
            found[name] = value
    return found


def _attributes(value: Any) -> dict[str, Any]:
    """The public attributes of an object; of an estimator of scikit-learn's kind, all."""
    found, whole = getattr(value, "__dict__", {}), hasattr(value, "get_params")
    return {name: item for name, item in found.items() if whole or not name.startswith("_")}


def _options(value: Any) -> dict[str, Any]:
    """The fields of a dataclass, or the public attributes of an object with its own __init__."""
    maker = next(kind for kind in type(value).__mro__ if "__init__" in vars(kind))
    if "__dataclass_fields__" in vars(maker):
        return {f.name: getattr(value, f.name) for f in dataclasses.fields(maker)}
    public = _attributes(value)
    if isinstance(value, Coupling):
        return public
    return {name: item for name, item in public.items() if _counts(item)}


def _counts(value: Any) -> bool:
    """Whether a user's function or object computes something else with another such value.

    A file, a lock, a logger or a progress bar does not count.
    """
    if isinstance(value, types.ModuleType):
        return False
    if isinstance(value, type):
        return _is_own(value)
    ours = dataclasses.is_dataclass(value) or callable(value)
    return ours or isinstance(value, (*HELD, *COLLECTIONS)) or _is_users(type(value))
