"""Point spread functions by Fourier optics, from the wavefront to cells on the detector (paper, section 5.1).

For one field point and wavelength: pupil function on a grid -> FFT -> intensity -> FFT -> optical transfer
function, times jitter (Gaussian), charge diffusion (Gaussian) and the 5 um cell (sinc), shifted, back to a
lattice of cells, two to a pixel. A stored number is a CELL INTEGRAL: the fraction of all the light of a star
that falls in that cell, so an array sums to the light inside its box (< 1).

* The intensity of a pupil of diameter D has no frequency above D/lambda. The grid pitch is the largest 1/k of
  a cell below lambda/2D, so every step up to the cell integrals is exact for the sampled pupil and no finer
  grid could change them.
* The pupil has at least 256 samples across, and as many as it takes for the period of the transform to be
  twice the box. Edge samples carry the share of their square inside the disc; the envelope (sinc) which that
  gives the far wings is divided out. A flux is good to 5e-5 of the star (tests: Airy's closed form).
* Angles become pixels by the camera's plate scale (0.074 arcsec per 10 um), the WCS's. 10 um at a focal length
  of exactly 28 m would be 0.07367 arcsec: the 0.5% lies in the nominal figures, and one scale is used throughout.
* Each node is centred on what a detector sees: the centroid, with a Gaussian window of 1.5 px (sigma), of the
  mean of the four wavelengths integrated over the pixel, is put on the middle of the array. The shift removed
  is kept as `tilt`, for the distortion model.

Cost: 0.16 CPU-s per PSF at 280 nm, 0.06 at 500 nm, 0.03 at 950 nm, and 0.3 s a wavelength to start.
The scattered halo (optics.halo) is added to the centred images, before they are written; the wing beyond the box
and the ghosts are described in the file's attributes.

Left out: polarisation, pupil vignetting over the field,
diffusion that depends on wavelength, the 1 degree turn of the grating chips against the pupil.
"""

import math

import numpy as np
import scipy.fft

from csstsim.errors import InputError
from csstsim.optics.psf_file import PsfSet, pixel_response, write_psf
from csstsim.optics.wavefront import load_wavefront, number
from csstsim.progress import progress
from csstsim.units import ARCSEC_PER_RAD

__all__ = [
    "Diffraction",
    "PsfSet",
    "blur",
    "make_psf",
    "node_positions",
    "node_psf",
    "pixel_response",
    "windowed_centroid",
]

CELLS = 256  # cells along the side of a stored PSF
CELLS_PER_PIXEL = 2
WINDOW_PX = 1.5  # sigma of the centring window
_PUPIL_SAMPLES = 256
_CENTRE_TOLERANCE_PX = 1e-5
_EDGE_STEPS = 32  # chords per pupil sample in the area of an edge sample


class Diffraction:
    """The optics at one wavelength: from Zernike coefficients to a transfer function, and on to cells.

    Units inside: image positions in cells, frequencies in cycles per cell.
    """

    def __init__(self, wavelength, diameter_m, cell_arcsec, wavefront, cells=CELLS):
        """`wavelength` in angstrom, `cell_arcsec` the side of a cell, `cells` (even) cells along the box."""
        lam_d = wavelength * 1e-10 / diameter_m * ARCSEC_PER_RAD / cell_arcsec  # cells
        self.cells = cells
        self.fold = math.floor(2 / lam_d) + 1  # grid points per cell
        self.period = 2 * scipy.fft.next_fast_len(math.ceil(max(2 * cells, _PUPIL_SAMPLES * lam_d) / 2), real=True)
        self.size = self.fold * self.period
        across = self.period / lam_d
        n = math.ceil(across) + 1
        u = (np.arange(n) - (n - 1) / 2) / (across / 2)
        mask = _disc_coverage(u)
        self.inside = mask > 0
        self.mask = mask[self.inside].astype(np.float32)
        self.light = float(mask.sum())
        to_radian = 2 * np.pi / (wavelength / 10)  # per nm
        self.basis = (to_radian * wavefront.basis(u, u)[:, self.inside]).astype(np.float32)
        self.screen = (to_radian * wavefront.screen(u, u)[self.inside]).astype(np.float32)
        self.frequency = scipy.fft.fftfreq(self.size) * self.fold

    def phase(self, coefficients):
        """Return the phase (radian) at the pupil samples inside the disc, whose weights are `mask`."""
        return self.screen + np.asarray(coefficients, np.float32) @ self.basis

    def transfer(self, coefficients):
        """Return the transfer function (size, size/2+1) for Zernike coefficients in nm.

        It is 1 at frequency 0 but for the light beyond the transform's period. Single precision up to the
        amplitude (its noise, 1e-7, is squared away), double from the intensity on.
        """
        phase = self.phase(coefficients)
        pupil = np.zeros(self.inside.shape, np.complex64)
        field = np.empty(phase.shape, np.complex64)
        np.multiply(self.mask, np.cos(phase), out=field.real)
        np.multiply(self.mask, -np.sin(phase), out=field.imag)  # e^-i phase, e^-i k x: GalSim's sign, conjugated
        pupil[self.inside] = field
        amplitude = scipy.fft.fft(pupil, self.size, axis=1, overwrite_x=True)
        amplitude = scipy.fft.fft(amplitude, self.size, axis=0, overwrite_x=True)
        intensity = np.square(amplitude.real, dtype=np.float64)
        intensity += np.square(amplitude.imag, dtype=np.float64)
        return scipy.fft.rfft2(intensity, overwrite_x=True) / (self.size**2 * self.light)

    def image(self, transfer, kernel, centre=(0.0, 0.0)):
        """Return the cells (cells, cells) around `centre` (x, y; in cells from the untilted wavefront's point).

        `kernel(frequency)` is the one-dimensional transfer function of all that blurs (see `blur`).
        """
        half = self.cells // 2
        rows = np.arange(-half, half)
        # A cell centre lies half a cell from the middle of the array
        turn = [np.exp(2j * np.pi * self.frequency * (0.5 + c)) * kernel(self.frequency) for c in centre]
        spectrum = transfer * turn[0][: self.size // 2 + 1]
        spectrum *= turn[1][:, None]
        spectrum = spectrum.reshape(self.fold, self.period, -1).sum(axis=0)  # keep one grid row in `fold`
        lines = scipy.fft.ifft(spectrum, axis=0, overwrite_x=True)[rows]
        cells = scipy.fft.irfft(lines, self.size, axis=1)[:, rows * self.fold] * self.fold
        envelope = [np.sinc((rows + 0.5 + c) / self.period) ** 2 for c in centre]
        return np.maximum(cells / (envelope[1][:, None] * envelope[0]), 0.0)  # clips rounding, 1e-16 of the peak


def _disc_coverage(u):
    """Return the share of each grid square inside the unit disc; the squares are centred on `u` x `u`."""
    step = u[1] - u[0]
    quarter = u[: (u.size + 1) // 2]  # the rest by symmetry
    share = np.zeros((quarter.size, quarter.size))
    for offset in (np.arange(_EDGE_STEPS) + 0.5) / _EDGE_STEPS - 0.5:
        chord = np.sqrt(np.maximum(1 - (quarter + offset * step) ** 2, 0))
        share += np.clip((chord - np.abs(quarter[:, None])) / step + 0.5, 0, 1)
    half = np.hstack([share, share[:, : u.size // 2][:, ::-1]])
    return np.vstack([half, half[: u.size // 2][::-1]]) / _EDGE_STEPS


def blur(psf_params, cell_arcsec, cell_um, *, cell=True):
    """Return kernel(frequency): jitter, charge diffusion and, if `cell`, the integral over a cell, along one axis.

    `psf_params`: `jitter` (arcsec rms per axis) and `diffusion` (um rms per axis). Frequency in cycles per cell.
    """
    jitter, diffusion = number(psf_params, "jitter"), number(psf_params, "diffusion")
    variance = (jitter / cell_arcsec) ** 2 + (diffusion / cell_um) ** 2
    return lambda f: np.exp(-2 * (np.pi * f) ** 2 * variance) * (np.sinc(f) if cell else 1.0)


def windowed_centroid(image, sigma):
    """Return (x, y), in samples from the array's middle, where the Gaussian-windowed first moments vanish.

    `sigma` in samples. Raises InputError when the iteration leaves the array: no compact source is there.
    """
    axis = np.arange(image.shape[0]) - (image.shape[0] - 1) / 2
    x = y = 0.0
    for _ in range(100):
        wx, wy = (np.exp(-0.5 * ((axis - c) / sigma) ** 2) for c in (x, y))
        line_x, line_y = wy @ image, image @ wx
        total = line_x @ wx
        # Twice the windowed mean: the window halves the step for a source as wide as itself
        dx, dy = 2 * (line_x @ (wx * (axis - x))) / total, 2 * (line_y @ (wy * (axis - y))) / total
        x, y = x + dx, y + dy
        if not math.hypot(x, y) < axis[-1]:
            break
        if math.hypot(dx, dy) < 1e-9:
            return x, y
    raise InputError("the centroid of a PSF does not converge: its wavefront error is too large", file="psf.yaml")


def node_psf(optics, coefficients, kernel):
    """Return (images (4, cells, cells), tilt (2,) px) of one node, centred together.

    `optics` holds one `Diffraction` a wavelength; `coefficients` in nm.
    """
    transfers = [o.transfer(coefficients) for o in optics]
    centre = np.zeros(2)
    for _ in range(5):
        images = np.stack([o.image(t, kernel, centre) for o, t in zip(optics, transfers, strict=True)])
        seen = pixel_response(images.mean(axis=0))
        step = np.array(windowed_centroid(seen, WINDOW_PX * CELLS_PER_PIXEL))
        if np.abs(step).max() < _CENTRE_TOLERANCE_PX * CELLS_PER_PIXEL:
            break
        centre += step
    return images, centre / CELLS_PER_PIXEL


def node_positions(chip, grid):
    """Return (grid^2, 2) pixel positions (x, y) of the nodes; the outer ones lie on the outer edges of the chip."""
    x = np.linspace(-0.5, chip.detector.nx - 0.5, grid)
    y = np.linspace(-0.5, chip.detector.ny - 0.5, grid)
    return np.stack([np.tile(x, grid), np.repeat(y, grid)], axis=1)


def mosaic_position(chip, x, y):
    """Return the position in the mosaic (px, origin on the boresight) of chip pixels x, y."""
    turn = math.radians(chip.rotation)
    dx, dy = x - (chip.detector.nx - 1) / 2, y - (chip.detector.ny - 1) / 2
    return chip.xc + math.cos(turn) * dx - math.sin(turn) * dy, chip.yc + math.sin(turn) * dx + math.cos(turn) * dy


def make_psf(
    path, chip, filter, telescope, psf_params, grid, *, camera_digest, provenance=None, cells=CELLS, beyond=None
):
    """Compute the PSFs of a chip and write them to `path` (layout: optics.psf_file).

    `psf_params` is Camera.psf, `grid` the number of nodes along a side (>= 2), `camera_digest` Camera.digest,
    `provenance` a JSON-like mapping kept in the file, `cells` the (even) cells along the box, `beyond` an
    optics.beyond.Beyond, whose halo is added to the images.
    """
    if grid < 2:
        raise InputError("too few nodes to span a chip", key="psf.grid", value=grid, allowed=">= 2")
    wavefront = load_wavefront(psf_params)
    cell_arcsec = telescope.pixel_scale / CELLS_PER_PIXEL
    cell_um = chip.detector.pixel_um / CELLS_PER_PIXEL
    optics = [Diffraction(w, telescope.diameter_m, cell_arcsec, wavefront, cells) for w in filter.psf_wavelength]
    kernel = blur(psf_params, cell_arcsec, cell_um)
    nodes = node_positions(chip, grid)
    coefficients = wavefront.coefficients(*mosaic_position(chip, nodes[:, 0], nodes[:, 1]))
    about = {
        "cell_um": cell_um,
        "cell_arcsec": cell_arcsec,
        "chip": chip.id,
        "filter": filter.name,
        "grid": grid,
        "camera_digest": camera_digest,
    }
    images = (node_psf(optics, row, kernel) for row in progress(coefficients, "PSF nodes"))
    if beyond is not None:
        about |= beyond.attributes()
        images = ((beyond.wing.add_to(image), tilt) for image, tilt in images)
    write_psf(path, nodes, filter.psf_wavelength, images, cells=cells, about=about, provenance=provenance or {})
