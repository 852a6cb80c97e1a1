"""FITS files of others, opened by astropy: what it raises or warns of becomes one InputError, or silence."""

import warnings
from contextlib import contextmanager
from pathlib import Path

from csstsim.base.errors import InputError
from csstsim.base.files.fits_headers import check_headers


@contextmanager
def opened(path, key=None):
    """Yield the HDUList of a FITS file, all of it in memory. Raises InputError, also for faults found inside.

    key: the option that names the file, for the message.
    """
    from astropy.io import fits

    path = Path(path)
    if not path.is_file():
        raise InputError("no such file", file=path, key=key)
    check_headers(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of keywords that other versions of the standard had
            with fits.open(path, memmap=False) as file:
                yield file
    except (InputError, MemoryError):
        raise
    except Exception as exc:  # astropy's are of many types
        what = f"cannot be read as FITS: {type(exc).__name__} {str(exc).splitlines()[0] if str(exc) else ''}"
        raise InputError(what.rstrip(), file=path, key=key) from None
