"""Trajectories of light behind a grating in front of the detector, to which traces are fitted (paper, section 4.2).

A substitute for ray tracing. A chief ray from the exit pupil with direction cosines (a, b, c) leaves a grating of
period g, ruled along y, as (a + k lambda / g, b, ...) in order k, and meets the detector at distance d. Its offset
there from the position without the grating is

    dx = d (a'/c' - a/c),   dy = d (b/c' - b/c)

(conical diffraction: traces bend and tilt for oblique rays). A wedge of the substrate adds the same offset to all
orders. A piece faces the chief ray of its chip's middle. Left out: aberrations of the grating, curved or chirped
rulings.
"""

import numpy as np

from csstsim.base.units import UM_PER_MM

POSITIONS, WAVELENGTHS = 10, 8  # along each side; along the band (paper, section 4.2)


def trajectories(chip, bounds, sign, filter, numbers, pupil_distance, positions=POSITIONS, wavelengths=WAVELENGTHS):
    """Return {order: (samples, 5)}: m, n [0-based px], lambda [angstrom], and x, y [px] where that light lands.

    bounds: (x0, x1, y0, y1) of the direct images; sign: of the first order's direction along x; filter: of the chip;
    numbers: gratings.yaml; pupil_distance: mm from the exit pupil, where chief rays start, to the detector.
    """
    lit = filter.wavelength[filter.throughput > 0]
    wave = np.linspace(lit[0], lit[-1], wavelengths)
    x0, x1, y0, y1 = bounds
    m, n = (v.ravel() for v in np.meshgrid(np.linspace(x0, x1, positions), np.linspace(y0, y1, positions)))
    # The pieces face the chief ray of the chip's middle, so the boresight does not matter
    middle = (chip.detector.nx - 1) / 2, (chip.detector.ny - 1) / 2
    lean = (np.stack([m, n], axis=1) - middle) * chip.detector.pixel_um / UM_PER_MM / pupil_distance
    c = 1.0 / np.sqrt(1.0 + (lean**2).sum(axis=1))
    a, b = (lean * c[:, None]).T
    pixels = numbers["distance"] * UM_PER_MM / chip.detector.pixel_um
    per_angstrom = sign / (numbers["dispersion"][filter.name] * pixels)  # 1 / g
    across = (wave - wave.mean()) / (wave[-1] - wave[0])
    wedge_x, wedge_y = numbers["offset"]
    wedge_x = sign * (wedge_x + numbers["spread"] * across)
    m, n, a, b, c = (v[:, None] for v in (m, n, a, b, c))
    out = {}
    for order in numbers["efficiency"]:
        turned = a + order * per_angstrom * wave
        depth = np.sqrt(1.0 - turned**2 - b**2)
        x = m + wedge_x + pixels * (turned / depth - a / c)
        y = n + wedge_y + pixels * (b / depth - b / c)
        out[order] = np.stack([v.ravel() for v in np.broadcast_arrays(m, n, wave, x, y)], axis=1)
    return out
