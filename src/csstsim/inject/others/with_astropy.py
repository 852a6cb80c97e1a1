"""FITS files of others, opened by astropy: what it raises or warns of becomes one InputError, or silence."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from csstsim.base.errors import InputError
from csstsim.io.fits import open_fits

if TYPE_CHECKING:
    from collections.abc import Sequence

    from astropy.io.fits import HDUList, Header

    from csstsim.base.types import PathLike


@contextmanager
def opened(path: PathLike, key: str | None = None) -> Iterator[HDUList]:
    """Yield the HDUList of a FITS file, all of it in memory. Raises InputError, also for faults found inside.

    Pixels of BLANK are NaN in an image that BSCALE makes one of floats, and stay as they are in one of integers.
    key: the option that names the file, for the message.
    """
    from astropy.io import fits

    path = Path(path)
    open_fits(path).close()  # refuses what is missing, or shorter than its headers say
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of keywords that other versions of the standard had
            with fits.open(path, memmap=False) as file:
                how = _integers([hdu.header for hdu in file])
            with fits.open(path, memmap=False, **how) as file:
                yield file
    except InputError:
        raise
    except MemoryError:
        raise InputError("announces more data than the memory holds", file=path, key=key) from None
    except Exception as exc:  # astropy's are of many types
        what = f"cannot be read as FITS: {type(exc).__name__} {str(exc).splitlines()[0] if str(exc) else ''}"
        raise InputError(what.rstrip(), file=path, key=key) from None


def _integers(headers: Sequence[Header]) -> dict[str, bool]:
    """Return how astropy opens a file so that images of integers stay such: it turns those with BLANK into floats."""
    if not any("BLANK" in header for header in headers) or any(header.get("BSCALE", 1) != 1 for header in headers):
        return {}
    signed = all(header.get("BZERO", 0) == 0 for header in headers)
    # ignore_blank does nothing for extensions, and unscaled ones of unsigned integers would be signed
    return {"do_not_scale_image_data": True} if signed else {"ignore_blank": True}
