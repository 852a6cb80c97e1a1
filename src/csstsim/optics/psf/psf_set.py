"""The PSF set of a chip: every node's PSF at the filter's four wavelengths (paper, section 5.1.1).

Each node's wavefront (optics.psf.wavefront, optics.psf.chip_errors) becomes cell integrals at four wavelengths
(optics.psf.diffraction). The number of cells along a pixel is a property of the set: 2 (5 um, a box of 128 px), or 4
(2.5 um, a box of 64 px) for filters where 2 do not reach the accuracy goal (psf.yaml; benchmarks/psf_sampling.py).

* Angles are converted to pixels by the plate scale of the WCS (0.074 arcsec per 10 um). At a focal length of exactly
  28 m, 10 um would be 0.07367 arcsec; the nominal figures differ by 0.5%, and one scale is used throughout.
* Each node is centred on the image that the detector sees: the centroid, in a Gaussian window of 1.5 px (sigma), of
  the mean of the four wavelengths integrated over the pixel, is moved to the middle of the array. The removed shift is
  stored as `tilt`, for the distortion model.

Cost: 12 to 21 CPU-ms per PSF, 44 to 76 CPU-s per set of 30 x 30 nodes (benchmarks/psf_quality.py --bands).
The scattered halo (optics.scatter.halo) is added to the centred images before they are written; the wing beyond the box
and the ghosts are described in the file's attributes. Left out: polarisation, pupil vignetting over the field,
diffusion that depends on wavelength, the 1 degree turn of the grating chips against the pupil.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.process.progress import progress
from csstsim.base.types import ComplexArray, FloatArray, PathLike
from csstsim.optics.psf.chip_errors import chip_coefficients
from csstsim.optics.psf.diffraction import NO_CENTROID, Diffraction, Kernel, blur, check_blur
from csstsim.optics.psf.psf_file import write_psf
from csstsim.optics.psf.sampling import CELLS, WINDOW_PX, oversampling_of
from csstsim.optics.psf.wavefront import Wavefront, load_wavefront

if TYPE_CHECKING:
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.filter import Filter
    from csstsim.optics.scatter.scattered_light import Scattered

_CENTRE_TOLERANCE_PX = 1e-6
_CENTRE_STEPS = 50


class PsfSampling(NamedTuple):
    """How a PSF set samples a chip."""

    grid: int  # nodes along a side, >= 2
    oversampling: int | str = "auto"  # cells along a pixel; "auto": that of psf.yaml for the filter
    cells: int = CELLS  # along the box, even
    nodes_uv: FloatArray | None = None  # (grid^2, 2) u, v of optics.geometry.focal_plane.samples at the nodes


def node_psf(
    optics: Sequence[Diffraction], coefficients: FloatArray, kernel: Kernel, oversampling: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Return (images (4, cells, cells), tilt (2,) px) of one node, centred together.

    `optics`: one `Diffraction` per wavelength; `coefficients`: in nm; `kernel`: from `blur`, the cell included;
    `oversampling`: cells along a pixel. Raises InputError if there is no compact image to centre.
    """
    transfers = [o.transfer(coefficients) for o in optics]
    centre = centre_of(optics, transfers, kernel, oversampling)
    return np.stack([o.image(t, kernel, centre) for o, t in zip(optics, transfers, strict=True)]), centre / oversampling


def centre_of(
    optics: Sequence[Diffraction], transfers: Sequence[ComplexArray], kernel: Kernel, oversampling: int
) -> FloatArray:
    """Return the windowed centroid (x, y), in cells, of the mean image as pixels see it.

    It is the peak of the image smoothed by the Gaussian, where the first moments in the window are zero. Raises
    InputError if none is found.
    """
    centre = np.zeros(2)
    sigma = WINDOW_PX * oversampling

    def seen(f: FloatArray) -> FloatArray:  # sum over the cells along a pixel
        return kernel(f) * oversampling * np.sinc(oversampling * f) / np.sinc(f)

    for _ in range(_CENTRE_STEPS):
        pairs = zip(optics, transfers, strict=True)
        light, x, y, xx, xy, yy = np.sum([o.smoothed(t, seen, sigma, centre) for o, t in pairs], axis=0)
        bend = xx * yy - xy**2
        if xx < 0 < bend:  # near the peak: Newton's step
            step = np.array([xy * y - yy * x, xy * x - xx * y]) / bend
        else:  # the windowed mean
            step = sigma**2 * np.array([x, y]) / light
        centre += step
        if not np.hypot(*centre) < optics[0].cells / 2:
            break
        if np.abs(step).max() < _CENTRE_TOLERANCE_PX * oversampling:
            return centre
    raise InputError(NO_CENTROID)


def node_positions(chip: Chip, grid: int) -> FloatArray:
    """Return (grid^2, 2) pixel positions (x, y) of the nodes; the outermost are on the outer edges of the chip."""
    x = np.linspace(-0.5, chip.detector.nx - 0.5, grid)
    y = np.linspace(-0.5, chip.detector.ny - 0.5, grid)
    return np.stack([np.tile(x, grid), np.repeat(y, grid)], axis=1)


def chip_optics(
    chip: Chip,
    filter: Filter,
    psf_params: Mapping[str, Any],
    wavefront: Wavefront,
    oversampling: int,
    cells: int = CELLS,
) -> tuple[list[Diffraction], Kernel]:
    """Return (one `Diffraction` per wavelength of the filter, kernel of the blurring, the cell included).

    oversampling: cells along a pixel; cells: along the box, which is cells / oversampling px wide.
    Raises InputError for numbers of the blurring that are impossible or too large.
    """
    check_blur(psf_params, chip.telescope.pixel_scale, chip.detector.pixel_um)
    cell_arcsec = chip.telescope.pixel_scale / oversampling
    cell_um = chip.detector.pixel_um / oversampling
    diameter = chip.telescope.diameter_m
    optics = [Diffraction(w, diameter, cell_arcsec, wavefront, cells) for w in filter.psf_wavelength]
    return optics, blur(psf_params, cell_arcsec, cell_um)


def make_psf(
    path: PathLike,
    chip: Chip,
    filter: Filter,
    psf_params: Mapping[str, Any],
    sampling: PsfSampling,
    *,
    camera_digest: str,
    provenance: Mapping[str, Any] | None = None,
    scattered: Scattered | None = None,
) -> None:
    """Compute the PSFs of a chip and write them to `path` (layout: optics.psf.psf_file).

    `psf_params`: Camera.psf; `sampling`: a PsfSampling, its nodes_uv (grid^2, 2) [deg] or None; `camera_digest`:
    Camera.digest; `provenance`: a JSON-like mapping stored in the file; `scattered`: scattered_light.Scattered, whose
    halo is added. Raises InputError for an invalid grid or sampling, and for a PSF too wide to centre.
    """
    grid = sampling.grid
    if grid < 2:
        raise InputError("too few nodes to span a chip", key="psf.grid", value=grid, allowed=">= 2")
    oversampling = oversampling_of(filter.name, psf_params, sampling.oversampling)
    wavefront = load_wavefront(psf_params)
    optics, kernel = chip_optics(chip, filter, psf_params, wavefront, oversampling, sampling.cells)
    nodes = node_positions(chip, grid)
    coefficients = chip_coefficients(wavefront, psf_params, chip, nodes[:, 0], nodes[:, 1])
    about = {
        "cell_um": chip.detector.pixel_um / oversampling,
        "cell_arcsec": chip.telescope.pixel_scale / oversampling,
        "oversampling": oversampling,
        "chip": chip.id,
        "filter": filter.name,
        "grid": grid,
        "camera_digest": camera_digest,
    }
    images = (node_psf(optics, row, kernel, oversampling) for row in progress(coefficients, "PSF nodes"))
    if scattered is not None:
        about |= scattered.attributes()
        wing = scattered.wing
        assert wing is not None  # scattered_light makes one
        images = ((wing.add_to(image, oversampling), tilt) for image, tilt in images)
    write_psf(
        path,
        nodes,
        filter.psf_wavelength,
        images,
        cells=sampling.cells,
        about=about,
        provenance=provenance or {},
        nodes_uv=sampling.nodes_uv,
    )
