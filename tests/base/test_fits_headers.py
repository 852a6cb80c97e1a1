"""Headers of FITS files read block by block: data are not taken for a header."""

import numpy as np
import pytest
from astropy.io import fits

from csstsim.base.errors import InputError
from csstsim.base.files.fits_headers import BLOCK, CARD, check_headers

CARDS = b"".join(card.ljust(CARD) for card in (b"NAXIS1  =                   -5", b"END"))


@pytest.mark.parametrize("blocks", [0.5, 1.0, 1.5, 2.0, 2.5])
def test_data_that_look_like_cards_are_data(tmp_path, blocks):
    """The last block of the first image, whole or not, holds a length that no header may have."""
    image = np.zeros(int(blocks * BLOCK), np.uint8)
    last = (len(image) - 1) // BLOCK * BLOCK
    image[last : last + len(CARDS)] = np.frombuffer(CARDS, np.uint8)
    file = tmp_path / "two.fits"
    fits.HDUList([fits.PrimaryHDU(image), fits.ImageHDU(np.zeros(7, np.int16))]).writeto(file)
    check_headers(file)
    content = file.read_bytes()
    assert content.count(b"NAXIS1  =                    7") == 1
    file.write_bytes(content.replace(b"NAXIS1  =                    7", b"NAXIS1  =                   -7"))
    with pytest.raises(InputError, match=r"NAXIS1.*-7"):
        check_headers(file)
