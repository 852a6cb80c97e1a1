"""Runs linear algebra on one thread while a product is made, so that its bits do not depend on the number of threads.

OpenBLAS, MKL and the like divide a matrix product among threads, and sums divided differently are rounded differently:
a PSF made by two threads differs from one thread's in 2% of its cells. Environment variables would have to be set
before numpy is imported, which is too late in a notebook. So every function that makes a product is decorated with
`one_thread`.

It limits the libraries that are loaded when it is entered. Numpy's always is, and products use no other with threads.
"""

import threading
from collections.abc import Callable
from contextlib import ContextDecorator
from typing import TypeVar

import numpy as np  # noqa: F401  its library must be there to be limited
from threadpoolctl import OpenBLASController, threadpool_limits

ResultT = TypeVar("ResultT")


class _OneThread(ContextDecorator):
    """A context and a decorator: `with one_thread:`, `@one_thread`.

    The limit holds for the whole process. If several are active at once, nested or side by side, the first sets the
    limit and the last restores the number before it.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._limits: threadpool_limits | None = None

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                self._limits = self._set(lambda: threadpool_limits(1))
            self._inside += 1

    def __exit__(self, *error: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                assert self._limits is not None  # set on entering
                self._set(self._limits.restore_original_limits)

    @staticmethod
    def _set(change: Callable[[], ResultT]) -> ResultT:
        """Return change(), from whichever thread of Python: threadpoolctl else heeds the first that ever set a number.

        A script that limits its libraries in the main thread and makes chips in others would not be limited here.
        """
        OpenBLASController.clear_controlling_thread(force=True)
        try:
            return change()
        finally:
            OpenBLASController.clear_controlling_thread(force=True)


one_thread = _OneThread()
