"""The depth of an exposure as survey tables state it: point sources in the aperture that holds 80% of their light."""

import numpy as np

SHARE = 0.8


def aperture_depth(stamp, variance, snr=5.0, share=SHARE):
    """Return (flux [electron] of a point source of that S/N in its aperture, radius [px]).

    stamp: odd square, the share of all a point's light in each pixel, its middle the point; variance: of background and
    read noise [electron^2 / px]. The aperture holds `share` of the light:
    S/N = share F / sqrt(share F + pi r^2 variance).
    Raises ValueError if the stamp does not hold that share.
    """
    half = len(stamp) // 2
    radius2 = np.add.outer(np.arange(-half, half + 1) ** 2, np.arange(-half, half + 1) ** 2).ravel()
    order = np.argsort(radius2, kind="stable")
    inside = np.cumsum(stamp.ravel()[order])
    first = np.searchsorted(inside, share)
    if first == len(inside):
        raise ValueError(f"the stamp holds {inside[-1]:.3f} of the light, less than {share}")
    # The area of the pixels that hold it, the last one in part
    before = inside[first - 1] if first else 0.0
    area = first + (share - before) / (inside[first] - before)
    return 0.5 * snr * (snr + np.sqrt(snr**2 + 4.0 * area * variance)) / share, float(np.sqrt(area / np.pi))
