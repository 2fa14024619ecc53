"""Compiled loops, kept on disk where that is possible."""

import contextlib
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numba.core import caching
from numpy.typing import NDArray
from tqdm import tqdm

from cotlearn.progress import said_on, watched

INSTALLED = "site-packages" in Path(__file__).parts


def compiled(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Numba's `njit` without Python's global lock, whose code is kept for the next process.

    A loop may call loops of its own file and of this one: Numba does not see changes in others.

    Numba keeps it beside the source, else in the user's folder of caches; of an installed package
    in the latter first, so that nothing is left when the package is removed. If neither can be
    written, as in a container that is read-only, the loops are compiled anew in each process.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        loop = njit(nogil=True, **options)(function)
        with contextlib.suppress(RuntimeError):  # there is no folder for the code
            loop._cache = _Kept(function)  # as `cache=True` does with Numba's own
        return loop

    return decorate


class _InUsersFolder(caching.CompileResultCacheImpl):
    """Keeps code beside the source only if no other folder can be written."""

    def __init__(self, function: Callable[..., Any]) -> None:
        kinds = caching.CompileResultCacheImpl._locator_classes
        self._locator_classes = sorted(kinds, key=lambda kind: "InTree" in kind.__name__)
        super().__init__(function)


class _Kept(caching.FunctionCache):
    """Numba's cache; a full disk or a damaged file costs only the time to compile anew."""

    _impl_class = _InUsersFolder if INSTALLED else caching.CompileResultCacheImpl

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        here = Path(__file__).stat()
        stamp = self._impl.locator.get_source_stamp(), here.st_mtime, here.st_size
        self._cache_file = caching.IndexDataCacheFile(
            self.cache_path, self._impl.filename_base, stamp
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The code of a signature, or None."""
        try:
            found = super().load_overload(sig, target_context)
            if found is None:
                _announce()
            return found
        except Exception as error:  # decoding a damaged file raises many kinds
            _warn(self.cache_path, error)
            with contextlib.suppress(OSError):
                self.flush()  # so that the next process finds it whole
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep the code of a signature, if that is possible."""
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _warn(self.cache_path, error)


_warned = _announced = False


def _announce() -> None:
    """Say once in a process why the first pairs take longer, if somebody looks."""
    global _announced
    if not _announced and watched():
        text = "compiling the pairing loops, once on this machine: some 10 s"
        tqdm.write(text, file=said_on())  # above a bar that is being drawn
    _announced = True


def _warn(folder: str, error: Exception) -> None:
    """Say once in a process that code is not kept."""
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(
            f"compiled loops are not kept in {folder} and take some seconds in each process: "
            f"{error or type(error).__name__}",
            RuntimeWarning,
            stacklevel=2,
        )


@compiled()
def at_rank(values: NDArray[np.float64], place: int) -> float:
    """What stands at a place of (n,) when sorted, by Hoare's selection; NaN must not be there.

    NumPy's partition is as fast, but Numba takes eight seconds to compile it.
    """
    some, low, high = values.copy(), 0, len(values) - 1
    while low < high:
        pivot, i, j = some[(low + high) // 2], low, high
        while i <= j:
            while some[i] < pivot:
                i += 1
            while some[j] > pivot:
                j -= 1
            if i <= j:
                some[i], some[j] = some[j], some[i]
                i, j = i + 1, j - 1
        if place <= j:
            high = j
        elif place >= i:
            low = i
        else:
            break
    return float(some[place])
