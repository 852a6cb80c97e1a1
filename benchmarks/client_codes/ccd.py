"""ccdproc (astropy's CCD tools) on Level-0 files: sections, overscan and trimming of every channel."""

import warnings

import numpy as np

from csstsim.io.level0 import read_level0


def channels(path):
    """Return {"channels": number, "bias": DN, "trimmed": bool} of a Level-0 file.

    Each channel is made an extension (Level0.extensions) and reduced by its sections alone. bias: the greatest
    difference of the overscan's level from the header's; trimmed: all pixels are those of csstsim's own reader.
    """
    import ccdproc
    from astropy.nddata import CCDData

    file, off, same, count = read_level0(path), [], [], 0
    hdus = file.extensions()
    for hdu, channel in zip(hdus[1:], file.channels(), strict=True):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            raw = CCDData(hdu.data.astype(np.float32), unit="adu", header=hdu.header)
            over = ccdproc.trim_image(raw, fits_section=hdu.header["BIASSEC"])
            level = np.ma.median(over.data[:, 4:])
            active = ccdproc.trim_image(raw, fits_section=hdu.header["TRIMSEC"])
            light = ccdproc.subtract_overscan(active, overscan=over[:, 4:], overscan_axis=1, median=True)
        block = next(b for b in file.readout.blocks if b.channel == channel.number)
        mine = channel.active[block.as_read].astype(np.float32)
        same.append(bool((active.data == mine).all()))
        off.append(abs(float(level) - channel.bias))
        row_level = np.median(over.data[:, 4:], axis=1)[:, None]
        same.append(bool(np.allclose(light.data, mine - row_level, atol=1e-3)))
        count += 1
    return {"channels": count, "bias": max(off), "trimmed": all(same)}
