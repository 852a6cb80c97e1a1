"""Limits linear algebra to one thread while a product is made, so that its bits do not depend on the number of threads.

OpenBLAS and MKL divide a matrix product among threads, and the rounding of sums depends on the division: a PSF computed
by two threads differs from that of one thread in 2% of its cells. Environment variables must be set before numpy is
imported, which is too late in a notebook. So every function that makes a product is decorated with `one_thread`.

Libraries are limited if they are loaded when `one_thread` is entered. Numpy's library always is, and products use no
other one with threads.
"""

import threading
from collections.abc import Callable
from contextlib import ContextDecorator
from typing import TypeVar

import numpy as np  # noqa: F401  loads its library, which can then be limited
from threadpoolctl import OpenBLASController, threadpool_limits

ResultT = TypeVar("ResultT")


class _OneThread(ContextDecorator):
    """A context and a decorator: `with one_thread:`, `@one_thread`.

    The limit is that of the process. If several are active, nested or in different threads, the first one sets the
    limit and the last one restores the original number.
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
        """Return change(), called from any thread of Python.

        By default, threadpoolctl follows only the first thread that has set a number. A script that limits its
        libraries in the main thread and simulates chips in other threads would not be limited here.
        """
        OpenBLASController.clear_controlling_thread(force=True)
        try:
            return change()
        finally:
            OpenBLASController.clear_controlling_thread(force=True)


one_thread = _OneThread()
