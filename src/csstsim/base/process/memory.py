"""Return of free memory to the system between the products of one process."""

import ctypes
import gc
from contextlib import suppress


def release() -> None:
    """Return free memory to the system: a chip's PSF set stays in reference cycles, and glibc keeps freed memory."""
    gc.collect()
    with suppress(AttributeError, OSError, TypeError):  # another C library than glibc
        ctypes.CDLL(None).malloc_trim(0)
