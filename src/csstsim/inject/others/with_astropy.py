"""FITS files of others, opened by astropy: what it raises or warns of becomes one InputError, or silence."""

import warnings
from contextlib import contextmanager
from pathlib import Path

from csstsim.base.errors import InputError
from csstsim.io.fits import open_fits


@contextmanager
def opened(path, key=None):
    """Yield the HDUList of a FITS file, all of it in memory. Raises InputError, also for faults found inside.

    key: the option that names the file, for the message.
    """
    from astropy.io import fits

    path = Path(path)
    open_fits(path).close()  # refuses what is missing, or shorter than its headers say
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of keywords that other versions of the standard had
            with fits.open(path, memmap=False) as file:
                yield file
    except InputError:
        raise
    except MemoryError:
        raise InputError("announces more data than the memory holds", file=path, key=key) from None
    except Exception as exc:  # astropy's are of many types
        what = f"cannot be read as FITS: {type(exc).__name__} {str(exc).splitlines()[0] if str(exc) else ''}"
        raise InputError(what.rstrip(), file=path, key=key) from None
