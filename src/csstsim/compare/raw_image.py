"""The stored pixels of a Level-0 file by readout channel: the same for every layout, compressed or not."""

from dataclasses import dataclass, replace

from csstsim.base.errors import InputError
from csstsim.detector.channels import ReadoutFrame
from csstsim.io.fits import image_header, read_header, read_pixels
from csstsim.io.level0 import read_level0

EXTENSIONS = "extensions"  # a channel each, as io.level0_extensions makes them
PLANES = ("IMAGE", "MASK")


@dataclass(frozen=True)
class RawImage:
    """A Level-0 file's pixels.

    readout: ReadoutFrame of the whole chip; layout: of detector.channels, or EXTENSIONS; planes: {name: stored array,
    of EXTENSIONS {channel: array}}; channels: numbers of those that were read.
    """

    readout: ReadoutFrame
    layout: str
    planes: dict
    channels: tuple

    def pixels(self, plane, block):
        """Return a channel's pixels, (block_ny, block_nx), its first to be read first; block: of `readout`."""
        stored = self.planes[plane]
        if self.layout == EXTENSIONS:
            return stored[block.channel]
        if self.layout != "channels":
            return stored[block.whole][block.as_read]
        return stored[:, block.stored_x0 : block.stored_x0 + self.readout.block_nx]


def raw_image(file, path):
    """Return the RawImage of an open FITS file, or None if it is not Level-0. Raises InputError if it is damaged."""
    if "IMAGE" in file and {"LAYOUT", "NCHAN"} <= read_header(file["IMAGE"], path).keys():
        header = image_header(file["IMAGE"], path)
        return _whole(file, path) if header.get("BITPIX") == 16 and header.get("BZERO") == 32768 else None
    names = [hdu.get_extname() for hdu in file][1:]
    if names and all(name.startswith("CHAN") and name[4:].isdecimal() for name in names):
        return _by_extensions(file, path)
    return None


def _whole(file, path):
    level0 = read_level0(path)
    readout = replace(level0.readout, window=(0, level0.readout.nx, 0, level0.readout.ny))
    planes = {name: read_pixels(file[name], path) for name in PLANES if name in file}
    for name, plane in planes.items():
        if plane.shape != readout.stored_shape(level0.layout):
            raise InputError("not of the image's shape", file=path, key=name, value=plane.shape)
    return RawImage(readout, level0.layout, planes, tuple(block.channel for block in level0.readout.blocks))


def _by_extensions(file, path):
    header = image_header(file[1], path)
    try:
        prescan, overscan, parallel = (header[name] for name in ("PSCAN1", "OSCAN1", "OSCAN2"))
        nx, ny = (int(part.split(":")[1]) for part in header["DETSIZE"].strip("[]").split(","))
        channel_nx = header["NAXIS1"] - prescan - overscan
        readout = ReadoutFrame(
            window=(0, nx, 0, ny), nx=nx, ny=ny, channels_x=nx // channel_nx, channels_y=2, channel_nx=channel_nx,
            channel_ny=ny // 2, prescan=prescan, overscan=overscan, parallel_overscan=parallel,
        )  # fmt: skip
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as exc:
        raise InputError(f"the header's geometry does not hold together: {exc}", file=path) from None
    pixels = {int(hdu.get_extname()[4:]): read_pixels(hdu, path) for hdu in list(file)[1:]}
    for number, plane in pixels.items():
        if plane.shape != (readout.block_ny, readout.block_nx) or not 1 <= number <= readout.n_channels:
            raise InputError("not a channel of this detector", file=path, key=f"CHAN{number:02d}", value=plane.shape)
    return RawImage(readout, EXTENSIONS, {"IMAGE": pixels}, tuple(sorted(pixels)))
