"""One thread for the linear algebra of a pairing."""

from __future__ import annotations

import contextlib
import functools

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> contextlib.AbstractContextManager[object]:
    """While it is open, NumPy's matrix products take one thread.

    Those of a pairing are too small for more. With more they would also wait for the cores on
    which the network trains: on two cores that made a pairing in the background take ten times
    as long.
    """
    limit: contextlib.AbstractContextManager[object] = _controller().limit(
        limits=1, user_api="blas"
    )
    return limit


@functools.cache
def _controller() -> ThreadpoolController:
    """Found once, because looking for the libraries takes milliseconds."""
    return ThreadpoolController()
