"""Gives memory back to the system between the products of one process."""

import ctypes
import gc
from contextlib import suppress


def release() -> None:
    """Give back what is free: reference cycles hold a chip's PSF set, and glibc keeps freed memory for itself."""
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):  # another C library has no such function
        ctypes.CDLL(None).malloc_trim(0)
