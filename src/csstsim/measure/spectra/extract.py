"""Quick extraction of slitless spectra along the true traces: the electrons of each column, and the flux.

Wavelengths are those of the pixel columns themselves, lambda(X) = (X - x - p) / q: nothing is resampled. A column's
electrons (measure.spectra.column_sums) are those of its pixels around the trace (measure.spectra.cutout), minus those
of other objects and orders (measure.spectra.spectral_model), with the object's profile across
(measure.spectra.line_profile). Flux is electrons divided by those of a spectrum of 1 photon / s / m2 / angstrom in the
same column, line profile included. Left out: the PSF's change along the trace, light of other traces beyond the ends of
their orders. The electrons of a column are assumed to be distributed as the profile, which is true on average only: a
line of a resolved galaxy is brighter than its light in its middle columns and fainter at its sides
(measure.spectra.line_image), and pixels of a strong line may be rejected. Sums over the whole line are right.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from csstsim.base.old_names import warn_old_name
from csstsim.base.types import AnyArray, BoolArray, ComplexArray, FloatArray, IntArray
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.table import ObjectTable
from csstsim.instrument.chip import Window
from csstsim.instrument.filter import GRID
from csstsim.measure.calibration.bad_pixels import BAD
from csstsim.measure.spectra.chosen_orders import DEFAULT_CHOICE, Choice, chosen_orders, shortened
from csstsim.measure.spectra.column_sums import CONTAMINATED_FROM, FLOOR, GAP, STRIP, summed_columns
from csstsim.measure.spectra.cutout import Cutout
from csstsim.measure.spectra.line_image import LineImage, point_transforms
from csstsim.measure.spectra.line_profile import (
    ACROSS,
    ALONG,
    OFFSETS,
    band_position,
    broadened,
    pixel_fractions,
    psf_profile,
)
from csstsim.measure.spectra.spectrum_columns import COLUMNS, CUT, DIM, IMAGED, LOST
from csstsim.measure.spectra.spectrum_trust import untrusted

if TYPE_CHECKING:
    from csstsim.measure.calibration.calibrate import Calibrated
    from csstsim.measure.spectra.line_fluxes import LineFluxes
    from csstsim.measure.spectra.line_profile import Shapes
    from csstsim.measure.spectra.spectral_model import BinnedSpectra, SpectralModel
    from csstsim.optics.psf.psf_file import PsfSet
    from csstsim.optics.scatter.halo import Wing
    from csstsim.optics.throughput.response import Response

APERTURE_FRACTION = 0.9  # of the flux in a column, in the rows of the aperture
# px, half the aperture
HALF_MIN = 4.0
HALF_MAX = 20.0
PAD = 4  # columns beyond the order's ends that the PSF reaches
DIM_BELOW = 0.05  # of the order's maximum sensitivity: no flux is given
CHUNK = 500  # spectra computed at a time
FAINTEST = 0.1  # of a pixel's noise: fainter light of other objects is not modelled
ERG_PER_CM2 = 1e3  # J / m2 in erg / cm2


@dataclass(frozen=True, eq=False)
class DispersedImage:
    """A frame with spectra, of a Window (ny, nx).

    `electrons` float32; `marks` uint8, bits FULL and BAD of measure.calibration.bad_pixels; `response`, with `part` of
    optics.throughput.response.Response, or None: 1; `read_noise` electrons; `others`: expected electrons of all orders,
    float32, or a function that returns them in boxes (SpectralModel.image), or None; `image_of_one`: function of a row
    of the orders' table, a Window and `faintest` that returns the electrons of this order in `others`
    (contamination.CataloguedLight), or None: those of its true spectrum; `subtract`: whether other orders are
    subtracted, or only stated.
    """

    window: Window
    electrons: FloatArray
    marks: IntArray
    response: Response | None
    read_noise: float
    others: FloatArray | Callable[..., FloatArray] | None = None
    image_of_one: Callable[[ObjectTable, Window, float], FloatArray] | None = None
    subtract: bool = True

    @classmethod
    def of(cls, calibrated: Calibrated, window: Window, others: FloatArray | None = None) -> Self:
        """Return the DispersedImage of a calibrate.Calibrated."""
        noise = float(np.mean(list(calibrated.read_noise.values())))
        return cls(window, calibrated.electrons, calibrated.marks, calibrated.response, noise, others)

    @cached_property
    def noise(self) -> float:
        """Return the noise of a pixel of sky [electron]."""
        sample = self.electrons[::8, ::8]
        marks = self.marks[::8, ::8]
        sample = sample[(marks & BAD == 0) & np.isfinite(sample)]
        sky = max(np.median(sample) if sample.size else 0.0, 0.0)
        return float(np.sqrt(max(sky + self.read_noise**2, FLOOR)))

    @property
    def faintest(self) -> float:
        """Electrons of a pixel below which other orders are not modelled."""
        return FAINTEST * self.noise


@dataclass(frozen=True, eq=False)
class Sources:
    """The objects whose spectra are extracted.

    `shapes`: line_profile.Shapes by row of the truth table; `spectra`: function of rows (n,) and edges that returns
    (n, bins) photon / s / m2 / angstrom, observed, in bins of `edges` [angstrom]; None: not known.
    """

    shapes: Shapes
    spectra: BinnedSpectra | None = None
    edges: FloatArray = None  # type: ignore[assignment]  # None where spectra are not known

    def each_spectrum(self, rows: IntArray) -> Iterator[tuple[int, FloatArray | None]]:
        """Yield (k, spectrum (bins,) of rows[k]) in order, computed CHUNK at a time; None if spectra are not known."""
        for first in range(0, len(rows), CHUNK):
            chunk = rows[first : first + CHUNK]
            spectra = [None] * len(chunk) if self.spectra is None else self.spectra(chunk, self.edges)
            yield from enumerate((s if s is None else np.asarray(s, float) for s in spectra), first)


class PsfFunctions(NamedTuple):
    """Functions of a chip position x, y [px] that return `_points` and line_image.point_transforms there."""

    points: Callable[[float, float], FloatArray]
    transforms: Callable[[float, float], ComplexArray]


class _Pixels(NamedTuple):
    """Columns of a trace in the window, their wavelengths [angstrom] and rows of the trace [px], each (n,)."""

    columns: IntArray
    wave: FloatArray
    centre: FloatArray


def extract_spectra(
    frame: DispersedImage,
    orders: ObjectTable,
    sources: Sources,
    model: SpectralModel,
    psf: PsfSet,
    wing: Wing | None = None,
    choice: Choice = DEFAULT_CHOICE,
    lines: LineFluxes | None = None,
    **old: Any,
) -> ObjectTable:
    """Return the ObjectTable of spectra (spectrum_columns.COLUMNS), one row per column of a spectrum.

    Parameters
    ----------
    frame : DispersedImage
        Its `others`, if given, are subtracted without the electrons of the extracted order.
    orders : ObjectTable
        The table of io.orders, with a row for each order of an object.
    sources : Sources
        Shapes and spectra of the objects.
    model : SpectralModel
        Of measure.spectra.spectral_model.
    psf : PsfSet
        Or an object with its `mixed` and `oversampling`.
    wing : Wing, optional
        Of the PSF (optics.scatter.halo).
    choice : Choice
        The spectra to extract (chosen_orders).
    lines : LineFluxes, optional
        Measures the emission lines of each spectrum (line_fluxes).
    **old
        `wanted`, `snr_min` and `ids`: fields of `choice`, as in earlier versions; deprecated.

    Returns
    -------
    ObjectTable
        Its metadata count the spectra, those that the window cuts, and what was left out (chosen_orders.LEFT_OUT).
    """
    if old:
        warn_old_name("give choice=Choice(orders, snr_min, ids)", goes="0.3.0")
        choice = choice._replace(**{"orders" if name == "wanted" else name: value for name, value in old.items()})
    chosen, left_out = chosen_orders(frame, orders, sources, model, choice)
    parts = [_empty_columns()]
    short = shortened(orders, model)
    counts = 0
    cut = 0
    point_profiles = psf.mixed(partial(_points, per_pixel=psf.oversampling, wing=wing))
    transforms: Callable[[float, float], ComplexArray] = psf.mixed(
        partial(point_transforms, per_pixel=psf.oversampling)  # type: ignore[arg-type]  # linear, too, but complex
    )  # type: ignore[assignment]
    psf_at = PsfFunctions(point_profiles, transforms)
    rows = np.flatnonzero(chosen)
    boxes = _boxes(orders.take(rows), model)
    image_electrons = _electrons_of_images(frame, orders, sources, model, boxes)
    if callable(frame.others):
        frame = replace(frame, others=frame.others(faintest=frame.faintest, boxes=boxes))
    for k, (_, spectrum) in zip(rows, sources.each_spectrum(orders["row"][rows]), strict=True):
        one = orders.take(slice(k, k + 1))
        found = _extract_one(frame, one, sources, spectrum, model, psf_at, lines, image_electrons)
        if found is not None:
            parts.append(found)
            counts += 1
            cut += int(short[k])
    columns = {name: np.concatenate([part[name] for part in parts]) for name in COLUMNS}
    left_out["unusable"] = int(chosen.sum()) - counts
    about = {
        "spectra": counts,
        "cut": cut,
        "snr_min": float(choice.snr_min),
        "orders": [int(n) for n in choice.orders],
    }
    return ObjectTable(columns, about | {"left_out": left_out})


def _boxes(orders: ObjectTable, model: SpectralModel) -> FloatArray:
    """Return (n, 4): x0, x1, y0, y1 [px] of boxes with all pixels that are used to extract the orders."""
    wave = model.limits[model.pairs(orders)]
    ends = (orders["x"] + orders["p"])[:, None] + orders["q"][:, None] * wave
    rows = (orders["y"] + orders["r"])[:, None] + orders["s"][:, None] * wave
    margin = PAD + 1
    height = HALF_MAX + GAP + STRIP + 3
    return np.stack(
        [ends.min(axis=1) - margin, ends.max(axis=1) + margin, rows.min(axis=1) - height, rows.max(axis=1) + height],
        axis=1,
    )


def _electrons_of_images(
    frame: DispersedImage, orders: ObjectTable, sources: Sources, model: SpectralModel, boxes: FloatArray
) -> FloatArray | None:
    """Return the expected electrons, in boxes, of objects with an image, treated as disks; None: there are none."""
    with_image = orders.take(np.flatnonzero(sources.shapes.image[orders["row"]]))
    if not len(with_image) or sources.spectra is None:
        return None
    return model.image(with_image, sources.shapes, sources.spectra, sources.edges, frame.window, frame.faintest, boxes)


def _near_images(
    image_electrons: FloatArray,
    window: Window,
    columns: IntArray,
    centre: FloatArray,
    half: float,
    electrons: FloatArray,
) -> BoolArray:
    """Return (n,) bool: columns near which `image_electrons` are more than CONTAMINATED_FROM of the column's electrons.

    image_electrons: of `_electrons_of_images`. Near is the aperture with its strips of sky: the flux of a disk is not
    where that of the image is, so its flux in the aperture alone may be too small.
    """
    rows = np.arange(len(image_electrons))[:, None] + window.y0
    near = np.abs(rows - centre) < half + GAP + STRIP
    near_electrons = (image_electrons[:, columns - window.x0] * near).sum(axis=0)
    return near_electrons > CONTAMINATED_FROM * np.abs(electrons)


def _empty_columns() -> dict[str, AnyArray]:
    return {name: np.zeros(0, dtype) for name, (dtype, _) in COLUMNS.items()}


def _points(cells: FloatArray, per_pixel: int, wing: Wing | None) -> FloatArray:
    """Return (2, 4, len(OFFSETS)): psf_profile of both axes."""
    return np.array([psf_profile(cells, per_pixel, axis, wing) for axis in (ALONG, ACROSS)])


def _extract_one(
    frame: DispersedImage,
    one: ObjectTable,
    sources: Sources,
    spectrum: FloatArray | None,
    model: SpectralModel,
    psf: PsfFunctions,
    lines: LineFluxes | None,
    image_electrons: FloatArray | None,
) -> dict[str, AnyArray] | None:
    """Return {name: (n,)} of one row of the orders' table; None if none of its columns is usable.

    spectrum: of its object, in bins of the sources' edges, or None; image_electrons: of `_electrons_of_images`.
    """
    shapes = sources.shapes
    edges = sources.edges
    row = int(one["row"][0])
    window = frame.window
    columns, wave, centre = _trace(one, model, window)
    if len(columns) == 0:
        return None
    fractions = shapes.fraction[row]
    radius = shapes.radius[row]
    position = float(np.clip(one["x"][0], 0, None)), float(np.clip(one["y"][0], 0, None))
    points = psf.points(*position)
    along = broadened(points[ALONG], fractions, radius[ALONG])
    across = broadened(points[ACROSS], fractions, radius[ACROSS])
    half = _half(across)
    reach = int(np.ceil(half + GAP + STRIP + 1))
    rows = np.arange(int(centre.min()) - reach, int(centre.max()) + reach + 2)
    own = None
    if frame.others is not None:
        box = Window(int(columns[0]), int(columns[-1]) + 1, int(rows[0]), int(rows[-1]) + 1)
        if frame.image_of_one is None:
            # if `others` are from the truth, its spectra are known
            own = model.image_of_one(one, shapes, spectrum, edges, box, frame.faintest)  # type: ignore[arg-type]
        else:
            own = frame.image_of_one(one, box, frame.faintest)
    cutout = Cutout.of(frame, columns, rows, centre, own)
    band, fraction = band_position(wave, model.bands)
    fractions_of_pixels = pixel_fractions(across, band, fraction, cutout.offset)
    values, weights = summed_columns(cutout, fractions_of_pixels, half, frame.read_noise)
    if (values["flags"] & LOST).all():
        return None
    values["flags"] |= untrusted(values, along)
    if shapes.image[row]:
        values["flags"] |= IMAGED
    elif image_electrons is not None:
        near_image = _near_images(image_electrons, window, columns, centre, half, values["electrons"])
        values["flags"] |= np.where(near_image, IMAGED, 0)
    unit = [1.0], GRID[[0, -1]]
    flat, expected = model.electrons(one, columns, along, unit, unit if spectrum is None else (spectrum, edges))
    if spectrum is None:
        expected = np.full(len(columns), np.nan)
    values |= _fluxes(values, flat, wave)
    values["flags"] |= CUT if one["cut"][0] else 0
    values |= {"column": columns, "y": centre, "wavelength": wave, "sensitivity": flat, "model": expected}
    values |= {name: np.full(len(columns), one[name][0]) for name in ("id", "row", "order")}
    if lines is not None:
        image = LineImage(partial(psf.transforms, *position), model.bands, fractions, radius, float(shapes.slant[row]))
        lines.add(one, values, along, model, image, weights)
    return {name: values[name].astype(dtype) for name, (dtype, _) in COLUMNS.items()}


def _trace(one: ObjectTable, model: SpectralModel, window: Window) -> _Pixels:
    """Return the pixels of the trace, PAD columns longer than the order."""
    x, y, p, q, r, s = (float(one[name][0]) for name in ("x", "y", "p", "q", "r", "s"))
    limits = model.limits[model.pair(one)]
    low, high = np.sort(x + p + q * limits)
    first = max(np.ceil(low) - PAD, window.x0)
    last = min(np.floor(high) + PAD + 1, window.x1)
    columns = np.arange(int(first), int(max(first, last)))
    wave = (columns - x - p) / q
    return _Pixels(columns, wave, y + r + s * np.clip(wave, *limits))


def _half(across: FloatArray) -> float:
    """Return half the aperture [px]: it contains APERTURE_FRACTION of a profile's flux at all of its wavelengths."""
    out = OFFSETS >= 0
    inside = across[:, out] - across[:, len(OFFSETS) - 1 - np.flatnonzero(out)]
    enough = (inside >= APERTURE_FRACTION * inside[:, -1:]).all(axis=0)
    return float(np.clip(np.ceil(OFFSETS[out][np.argmax(enough)]), HALF_MIN, HALF_MAX))


def _fluxes(found: Mapping[str, AnyArray], flat: FloatArray, wave: FloatArray) -> dict[str, AnyArray]:
    """Return flux, flux_err, flux_erg, and the flags with DIM; flat (n,): sensitivity of the columns."""
    dim = flat < DIM_BELOW * flat.max()
    sensitivity = np.where(dim, np.nan, flat)
    flux = found["electrons"] / sensitivity
    error = found["electrons_err"] / sensitivity
    erg = flux * H_J_S * C_A_S / wave * ERG_PER_CM2
    return {"flux": flux, "flux_err": error, "flux_erg": erg, "flags": found["flags"] | np.where(dim, DIM, 0)}
