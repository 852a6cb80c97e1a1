"""Read Level-0 files: the raw product of one chip in one exposure (paper, section 4.4 and Appendix B item 15).

HDU 0 holds keywords only. IMAGE holds DN as uint16 in one of the layouts of csstsim.detector.channels, always of the
whole detector: pixels outside a windowed readout are 0, and READX0..READY1 state the window. MASK, an option of
quantization_and_output, has the bits of csstsim.detector.mask in the layout of the image. The keywords come from
level0_keywords.yaml. The WCS without letter is that of the assembled active frame (9216 x 9232); those with letters A,
B, ... are the same for the stored pixels of channels 1, 2, ... All are linear: if FLDDIST in the primary header is T,
they err by up to 200 px. With quantization_and_output's `sip` the first WCS includes the distortion and there are
none with letters. Layout `chip` has none either, because the first WCS is that of its pixels. io.sections gives the
position of each channel's pixels. Level0.extensions makes each channel an extension with its own WCS.
io.level0_writing writes the files.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.types import IntArray, PathLike
from csstsim.catalog.astrometry.ephemeris import Observer, observer
from csstsim.detector.channels import LAYOUTS, Block, ReadoutFrame
from csstsim.instrument.chip import Window
from csstsim.io.fits import image_header, open_fits, read_header, read_pixels, verify_hdu
from csstsim.io.sections import stored_slices

if TYPE_CHECKING:
    from astropy.io.fits import HDUList


# The keywords of IMAGE that reading needs; level0_keywords.yaml must keep them.
REQUIRED = (
    "NCHAN", "LAYOUT", "DETSIZE", "PSCAN1", "OSCAN1", "OSCAN2", "READX0", "READX1", "READY0", "READY1",
)  # fmt: skip
# ... and those of HDU 0 that are needed to convert apparent positions to ICRS.
SPACECRAFT_STATE = ("EXPSTART", "POSI0_X", "POSI0_Y", "POSI0_Z", "VELO0_X", "VELO0_Y", "VELO0_Z")
EPHEMERIS = ("EPHEM", "LDPLANET")
_SIZE = re.compile(r"(?:\[1:)?(\d+)(?:,1:| x )(\d+)\]?")  # also the older form: 9216 x 9232


@dataclass(frozen=True)
class Channel:
    """One readout channel of a Level-0 file, oriented as on the chip.

    Attributes
    ----------
    number : int
        The channel, from 1.
    window : Window
        The pixels of the chip that `active` has.
    active, prescan, serial_overscan, parallel_overscan : ndarray of uint16, shape (rows, columns)
        The pixels of each region [DN].
    gain, bias, read_noise : float or None
        e-/DN, DN and e-, as the header states them; None if it does not.
    """

    number: int
    window: Window
    active: IntArray
    prescan: IntArray
    serial_overscan: IntArray
    parallel_overscan: IntArray
    gain: float | None
    bias: float | None
    read_noise: float | None


@dataclass(frozen=True, eq=False)
class Level0:
    """A Level-0 file opened for reading, by `read_level0`. Pixels are read when a method needs them.

    Attributes
    ----------
    path : Path
        The file.
    header0, header : dict
        {keyword: value} of the primary header and of IMAGE.
    readout : ReadoutFrame
        The readout frame: the active pixels of the window with prescan and overscans.
    layout : str
        How IMAGE stores the readout frame: a name of csstsim.detector.channels.LAYOUTS.
    data_start : int or None
        Byte of the file at which the pixels start; None if they are compressed.
    """

    path: Path
    header0: dict[str, Any]
    header: dict[str, Any]
    readout: ReadoutFrame
    layout: str
    data_start: int | None

    @property
    def window(self) -> Window:
        """The Window of active pixels that was read."""
        return Window(*self.readout.window)

    @cached_property
    def gain(self) -> dict[int, float]:
        """{channel: e-/DN}; empty if the file does not state it."""
        return self.per_channel("GAIN")

    @cached_property
    def nonlinearity(self) -> dict[int, tuple[float, float]]:
        """{channel: (quadratic [1/e-], cubic [1/e-^2])}; empty if the file does not state it."""
        quadratic = self.per_channel("NLQ")
        cubic = self.per_channel("NLC")
        return {n: (quadratic[n], cubic[n]) for n in quadratic.keys() & cubic.keys()}

    @cached_property
    def levels(self) -> dict[int, tuple[float, float]]:
        """{channel: (bias [DN], read noise [e-])} as the file states them; empty if it does not."""
        bias = self.per_channel("DETBIA")
        noise = self.per_channel("RON")
        return {n: (bias[n], noise[n]) for n in bias.keys() & noise.keys()}

    def per_channel(self, prefix: str) -> dict[int, float]:
        """Return {channel: value} of the keywords PREFIXnn of IMAGE.

        Parameters
        ----------
        prefix : str
            The keyword without its two digits, such as "RON".

        Returns
        -------
        dict
            {channel: value}; a channel without the keyword is omitted.

        Raises
        ------
        InputError
            If a value is not a number.
        """
        names = {n: f"{prefix}{n:02d}" for n in range(1, self.readout.n_channels + 1)}
        return {n: self._number(self.header, name) for n, name in names.items() if name in self.header}

    @cached_property
    def _stored(self) -> IntArray:
        """The stored pixels [DN less 32768]: memory-mapped, or, if they are compressed, read completely."""
        if self.data_start is None:
            with open_fits(self.path) as file:
                pixels = read_pixels(file["IMAGE"], self.path)
            if pixels.dtype != np.uint16:
                raise InputError("DN are not uint16", file=self.path, key="BZERO", value=str(pixels.dtype))
            return (pixels ^ np.uint16(0x8000)).view(np.int16)
        shape = self.readout.stored_shape(self.layout)
        return np.memmap(self.path, ">i2", mode="r", offset=self.data_start, shape=shape)

    @cached_property
    def observer(self) -> Observer:
        """The spacecraft's position and velocity at the start, as a catalog.astrometry.ephemeris.Observer.

        Raises InputError if a keyword is missing.
        """
        missing = [name for name in (*SPACECRAFT_STATE, *EPHEMERIS) if name not in self.header0]
        if missing:
            raise InputError("the header does not give the spacecraft's state", file=self.path, key=missing[0])
        numbers = [self._number(self.header0, name) for name in SPACECRAFT_STATE]
        position = tuple(numbers[1:4])
        velocity = tuple(numbers[4:])
        return observer(numbers[0], position, velocity, *(self.header0[name] for name in EPHEMERIS))

    def _number(self, header: Mapping[str, Any], name: str) -> float:
        try:
            return float(header[name])
        except (TypeError, ValueError):
            raise InputError("must be a number", file=self.path, key=name, value=header[name]) from None

    def frame(self) -> IntArray:
        """Return the readout frame.

        Returns
        -------
        ndarray of uint16, shape `readout.shape`
            All pixels that were read, prescan and overscans included [DN], oriented as on the chip.

        Raises
        ------
        InputError
            If the DN of a compressed file are not uint16.
        """
        frame = self.readout.from_stored(self._stored, self.layout)
        if not frame.dtype.isnative:  # in place, because the frame of a complete chip has 190 MB
            frame = frame.byteswap(inplace=True).view(frame.dtype.newbyteorder())
        frame = frame.view(np.uint16)
        frame ^= np.uint16(0x8000)
        return frame

    def mask(self) -> IntArray | None:
        """Return the truth mask of the active pixels.

        Returns
        -------
        ndarray of uint8, shape (ny, nx) of the window, or None
            The bits of csstsim.detector.mask; None if the file has no mask.

        Raises
        ------
        InputError
            If the shape of the mask is not that of the image.
        """
        with open_fits(self.path) as file:
            stored = read_pixels(file["MASK"], self.path) if "MASK" in file else None
        if stored is not None and stored.shape != self.readout.stored_shape(self.layout):
            raise InputError("not of the image's shape", file=self.path, key="MASK", value=stored.shape)
        return None if stored is None else self.readout.active(self.readout.from_stored(stored, self.layout))

    def assembled(self, full: bool = False) -> IntArray:
        """Return the active pixels as one image.

        Parameters
        ----------
        full : bool
            The image has the complete chip, with 0 outside the window, instead of the window alone.

        Returns
        -------
        ndarray of uint16, shape (ny, nx)
            DN, oriented as on the chip.

        Examples
        --------
        `image = read_level0(path).assembled()`
        """
        window = self.window
        x0, y0 = (window.x0, window.y0) if full else (0, 0)
        image = np.zeros((self.readout.ny, self.readout.nx) if full else window.shape, np.uint16)
        for block in self.readout.blocks:
            y, x = block.image
            image[y0 + y.start : y0 + y.stop, x0 + x.start : x0 + x.stop] = self._region(block, block.active)
        return image

    def channels(self) -> Iterator[Channel]:
        """Yield the channels that were read, in Level-0 order.

        Yields
        ------
        Channel
            Pixels and electronics of one channel.
        """
        window = self.window
        for block in self.readout.blocks:
            y, x = block.image
            number = f"{block.channel:02d}"
            yield Channel(
                number=block.channel,
                window=Window(x.start + window.x0, x.stop + window.x0, y.start + window.y0, y.stop + window.y0),
                active=self._region(block, block.active),
                prescan=self._region(block, block.prescan),
                serial_overscan=self._region(block, block.serial_overscan),
                parallel_overscan=self._region(block, block.parallel_overscan),
                gain=self.header.get(f"GAIN{number}"),
                bias=self.header.get(f"DETBIA{number}"),
                read_noise=self.header.get(f"RON{number}"),
            )

    def _region(self, block: Block, region: tuple[slice, slice]) -> IntArray:
        """Return the pixels of a region of a block, which is contiguous on the chip, from the file."""
        shape = tuple(extent.stop - extent.start for extent in region)
        if not all(shape):
            return np.zeros(shape, np.uint16)
        return _unsigned(self._stored[stored_slices(self.readout, block, region, self.layout)])

    def extensions(self) -> HDUList:
        """Return the file as a mosaic for ds9 and ccdproc, with one image extension for each channel that was read.

        Returns
        -------
        astropy.io.fits.HDUList
            io.level0_extensions describes it. Its method `writeto(path)` writes it to a file.
        """
        from csstsim.io.level0_extensions import extensions

        return extensions(self)


def _unsigned(stored: IntArray) -> IntArray:
    """Return DN from big-endian int16 with BZERO 32768."""
    return stored.astype(np.int16).view(np.uint16) ^ np.uint16(0x8000)


def read_level0(path: PathLike, verify: bool = False) -> Level0:
    """Open a Level-0 file.

    Parameters
    ----------
    path : str or Path
        The FITS file.
    verify : bool
        Also compare the checksums of all extensions with their data.

    Returns
    -------
    Level0
        The headers, and methods that read the pixels.

    Raises
    ------
    InputError
        If the file is missing, cut short, damaged or not a Level-0 file of csstsim.

    Examples
    --------
    `file = read_level0(path)`, then `file.header["LAYOUT"]`, `file.window` and `file.assembled()`.
    """
    try:
        with open_fits(path) as file:
            if verify:
                for hdu in file:
                    verify_hdu(hdu, path)
            if "IMAGE" not in file:
                raise InputError("not a Level-0 file: it has no IMAGE extension", file=path)
            image = file["IMAGE"]
            header0 = read_header(file[0], path)
            header = image_header(image, path)
            data_start = None if image.is_compressed() else image.get_offsets()["data_start"]
    except (OSError, ValueError) as exc:  # also bytes that are not text
        raise InputError(f"a header is damaged: {type(exc).__name__}", file=path) from exc
    missing = [name for name in REQUIRED if name not in header]
    if missing:
        raise InputError("not a Level-0 file of csstsim: keywords are missing", file=path, value=", ".join(missing))
    layout = header["LAYOUT"]
    if layout not in LAYOUTS:
        raise InputError("unknown layout", file=path, key="LAYOUT", value=layout, allowed=", ".join(LAYOUTS))
    try:
        readout = _readout(header)
        shape = (header["NAXIS2"], header["NAXIS1"])
        stored_shape = readout.stored_shape(layout)
    except (AttributeError, KeyError, TypeError, ValueError) as exc:
        raise InputError(f"the header's geometry is inconsistent: {exc}", file=path) from None
    if header["BITPIX"] != 16 or shape != stored_shape:
        allowed = f"BITPIX 16 and {stored_shape}"
        raise InputError(
            "not the pixels that the header describes", file=path, value=(header["BITPIX"], shape), allowed=allowed
        )
    return Level0(Path(path), dict(header0), dict(header), readout, layout, data_start)


def _readout(header: Mapping[str, Any]) -> ReadoutFrame:
    size = _SIZE.fullmatch(header["DETSIZE"])
    nx, ny = map(int, size.groups())  # type: ignore[union-attr] # read_level0 catches the AttributeError
    channels_x = header["NCHAN"] // 2
    return ReadoutFrame(
        window=(header["READX0"] - 1, header["READX1"], header["READY0"] - 1, header["READY1"]),
        nx=nx,
        ny=ny,
        channels_x=channels_x,
        channels_y=2,
        channel_nx=nx // max(channels_x, 1),
        channel_ny=ny // 2,
        prescan=header["PSCAN1"],
        overscan=header["OSCAN1"],
        parallel_overscan=header["OSCAN2"],
    )
