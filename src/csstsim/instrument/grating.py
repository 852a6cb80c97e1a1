"""Gratings: trace, dispersion and throughput of each order (paper, section 4.2).

The parameters of a grating are those of its aXe configuration (instrument.axe). Two gratings, side by side, cover a
slitless chip. Light passes the grating on the side of its direct image. Not modelled: a beam that crosses the line
between the gratings is not divided, and the frame of a grating blocks a complete beam or nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from csstsim.base.arrays.bounds import Bounds
from csstsim.base.errors import InputError
from csstsim.base.model import Data, Number, Whole, between, validate
from csstsim.base.resampling import on_grid
from csstsim.base.types import FloatArray, Floats, PathLike
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.axe import BEAMS, COEFFICIENTS, field_range, field_terms, read_axe
from csstsim.instrument.chip import Chip
from csstsim.instrument.filter import GRID, Filter
from csstsim.instrument.telescope import Telescope

_TOLERANCE = 0.01  # of the peak: first order's sensitivity minus the filter curve, which defines magnitudes
_MAX_DISTANCE = 20_000  # px from the direct image, twice the size of a chip: larger values are errors in a file
_ERG_CM2 = 1e-3  # erg / cm2 in J / m2


@dataclass(frozen=True, eq=False)
class DiffractionOrder:
    """One diffraction order of a grating."""

    number: int
    extent: tuple[float, float]  # (first, last) [px] along x from the direct image
    coefficients: FloatArray  # (6 coefficients, 6 terms): axe.COEFFICIENTS by axe.TERMS
    throughput: FloatArray  # on filter.GRID, electron / photon that enters the aperture

    def lines(self, x: Floats, y: Floats) -> FloatArray:
        """Return (n, 4): p, q, r, s of dx = p + q lambda, dy = r + s lambda [px] from direct images x, y (n,) [px]."""
        xoff, yoff, a0, a1, alpha0, alpha1 = self.coefficients_at(x, y).values()
        q = 1.0 / (alpha1 * np.sqrt(1.0 + a1 * a1))
        p = xoff - alpha0 * q
        return np.stack([p, q, yoff + a0 + a1 * (p - xoff), a1 * q], axis=-1)

    def coefficients_at(self, x: Floats, y: Floats) -> dict[str, FloatArray]:
        """Return {name: array} of the trace's coefficients (axe.COEFFICIENTS) at direct images x, y [0-based px]."""
        values = np.einsum("ck,...k->c...", self.coefficients, field_terms(x, y))
        return dict(zip(COEFFICIENTS, values, strict=True))

    @property
    def range(self) -> tuple[float, float]:
        """(first, last) wavelength [angstrom] that the order passes."""
        used = np.flatnonzero(self.throughput)
        return float(GRID[used[0]]), float(GRID[used[-1]])


@dataclass(frozen=True, eq=False)
class Grating:
    """One grating; `orders` {number: DiffractionOrder}, rising."""

    name: str
    orders: dict[int, DiffractionOrder]


class Span(NamedTuple):
    """Extent of a spectrum from its direct image [px]: negative to the left and down."""

    left: float
    right: float
    down: float
    up: float


class GratingPiece(NamedTuple):
    """A grating and the Bounds [px] of the direct images whose light passes it."""

    grating: Grating
    bounds: Bounds


@dataclass(frozen=True, eq=False)
class Gratings:
    """The two gratings of a chip. Light with a direct image outside `bounds` [px] does not pass them."""

    left: Grating
    right: Grating
    split: float  # direct images of the left grating are at x < split - 0.5, on columns below `split`
    bounds: Bounds

    @property
    def pieces(self) -> list[GratingPiece]:
        """The GratingPiece of the left and the right grating."""
        line = self.split - 0.5
        left = GratingPiece(self.left, self.bounds._replace(x1=line))
        return [left, GratingPiece(self.right, self.bounds._replace(x0=line))]

    @property
    def numbers(self) -> list[int]:
        """The numbers of all orders of both gratings, rising."""
        return sorted(set(self.left.orders) | set(self.right.orders))

    def span(self, x: float, y: float) -> Span:
        """Return the Span of the zeroth and first order of an object with the direct image x, y [px]."""
        grating = self.pieces[int(x >= self.split - 0.5)].grating
        ends = [(0.0, 0.0)]
        for order in (grating.orders[number] for number in (0, 1) if number in grating.orders):
            p, q, r, s = order.lines(x, y)
            ends += [(p + q * wave, r + s * wave) for wave in order.range]
        along, across = zip(*ends, strict=True)
        return Span(min(along), max(along), min(across), max(across))

    @cached_property
    def reach(self) -> float:
        """The maximum distance of light from its direct image, along x or y [px]."""
        return max(_reach(order, bounds) for grating, bounds in self.pieces for order in grating.orders.values())


def _reach(order: DiffractionOrder, bounds: Bounds) -> float:
    x0, x1, y0, y1 = bounds
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(x0, x1, 5), np.linspace(y0, y1, 5)))
    p, q, r, s = order.lines(x, y).T
    return float(max(np.abs([p + q * wave, r + s * wave]).max() for wave in order.range))


Name = Annotated[str, Field(min_length=1)]  # of a .conf file
Reach = Annotated[Number, between(0, _MAX_DISTANCE)]


@dataclass(frozen=True, eq=False, repr=False)
class _Row(Data):
    """A chip's entry of gratings.yaml; a single grating over the full chip is given on both sides."""

    left: Name
    right: Name
    split: Annotated[Whole, Field(ge=1)]
    reach: tuple[Reach, Reach, Reach, Reach]


def load_gratings(
    folder: PathLike,
    data: Mapping[str, Any],
    chips: Mapping[int, Chip],
    filters: Mapping[str, Filter],
    telescope: Telescope,
) -> dict[int, Gratings]:
    """Return {chip id: Gratings} of the slitless `chips` {id: Chip}; their bounds are in pixels.

    folder: that of the .conf files; data: gratings.yaml as read by instrument.load.read_data. Raises InputError for a
    missing chip or file, a dispersion that changes sign within a piece, or sensitivities that differ from the filters'.
    """
    folder = Path(folder)
    by_name: dict[tuple[str, str], Grating] = {}
    by_chip: dict[int, Gratings] = {}
    file = folder.with_name("gratings.yaml")
    rows = data.get("chips")
    if not isinstance(rows, dict):
        raise InputError("must be a mapping of chips", file=file, key="chips", value=rows)
    for number in set(rows) - set(chips):
        raise InputError("not a chip with gratings", file=file, key="chips", value=number, allowed=sorted(chips))
    for number, chip in chips.items():
        row = validate(_Row, rows.get(number), file, ("chips", number))
        nx = chip.detector.nx
        ny = chip.detector.ny
        if row.split >= nx:
            key = f"chips.{number}.split"
            raise InputError("must be a column", file=file, key=key, value=row.split, allowed=f"1..{nx - 1}")
        for name in {(row.left, chip.filter), (row.right, chip.filter)} - set(by_name):
            by_name[name] = load_grating(folder / f"{name[0]}.conf", filters[chip.filter], telescope)
        left, right, low, high = row.reach
        bounds = Bounds(-0.5 - left, nx - 0.5 + right, -0.5 - low, ny - 0.5 + high)
        gratings = by_name[row.left, chip.filter], by_name[row.right, chip.filter]
        by_chip[number] = Gratings(*gratings, float(row.split), bounds)
        for grating, piece in by_chip[number].pieces:
            _check_traces(grating, piece, folder / f"{grating.name}.conf")
    return by_chip


def _check_traces(grating: Grating, bounds: Bounds, file: Path) -> None:
    """Raise InputError unless each order disperses in the right direction for all direct images, and to its extent."""
    letters = {order: beam for beam, order in BEAMS.items()}
    first_order_sign = 0.0
    where = "direct images at x {:g}..{:g}, y {:g}..{:g}".format(*bounds)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for number in sorted(grating.orders, key=lambda k: k != 1):  # the first order before the others
            order = grating.orders[number]
            key = f"DLDP_{letters[number]}_1"
            alpha1 = order.coefficients[list(COEFFICIENTS).index("alpha1")]
            limits = field_range(alpha1, *bounds)
            if not limits[0] * limits[1] > 0:
                raise InputError("must have one sign for " + where, file=file, key=key, value=limits)
            first_order_sign = first_order_sign or limits[0]
            if number * first_order_sign * limits[0] < 0:
                raise InputError(
                    f"wrong sign of order {number:+d}",
                    file=file,
                    key=key,
                    value=limits,
                    allowed="beams A to E are +1, 0, +2, -1, -2",
                )
            distance = _reach(order, bounds)
            if not distance < _MAX_DISTANCE:
                raise InputError(
                    f"the trace is too far from its direct image, for {where}",
                    file=file,
                    key=f"BEAM{letters[number]}",
                    value=distance,
                    allowed=f"up to {_MAX_DISTANCE} px",
                )
            p, q, *_ = order.lines(0.5 * (bounds.x0 + bounds.x1), 0.5 * (bounds.y0 + bounds.y1))
            # no BLAS: its threads cost more than the sum
            mean_wavelength = (GRID * order.throughput).sum() / order.throughput.sum()
            middle = float(p + q * mean_wavelength)
            if not order.extent[0] <= middle <= order.extent[1]:
                raise InputError(
                    f"the middle of the order is outside its extent (is DLDP in px and angstrom?), for {where}",
                    file=file,
                    key=f"BEAM{letters[number]}",
                    value=middle,
                    allowed=f"{order.extent} px",
                )


def load_grating(path: PathLike, filter: Filter, telescope: Telescope) -> Grating:
    """Return the Grating of an aXe file: coefficients (6,), throughputs [e- / photon]. Raises InputError."""
    path = Path(path)
    orders: dict[int, DiffractionOrder] = {}
    for number, beam in sorted(read_axe(path).items()):
        _check_in_folder(path, beam["sensitivity"])
        throughput = _throughput(path.parent / beam["sensitivity"], telescope)
        coefficients = np.stack([beam[name] for name in COEFFICIENTS])
        orders[number] = DiffractionOrder(number, beam["extent"], coefficients, throughput)
    difference = np.abs(orders[1].throughput - filter.throughput).max() / filter.throughput.max()
    if not difference < _TOLERANCE:
        raise InputError(
            f"the first order's sensitivity is not the throughput of {filter.name} in filters.yaml: magnitudes would "
            "not match the rendered flux",
            file=path,
            key="SENSITIVITY_A",
            value=f"off by {difference:.3f} of the peak",
            allowed=f"{_TOLERANCE}",
        )
    return Grating(path.stem, orders)


def _check_in_folder(path: Path, name: str) -> None:
    """Raise InputError for a sensitivity file that is not part of the camera's digest (load.data_files)."""
    file = Path(name)
    if file.is_absolute() or ".." in file.parts or file.name.startswith(".") or ".fits" not in file.suffixes:
        raise InputError(
            "not a data file of the camera",
            file=path,
            key="SENSITIVITY",
            value=name,
            allowed="a .fits file in this folder",
        )


def _throughput(path: Path, telescope: Telescope) -> FloatArray:
    """Return the throughput on GRID [e- / photon] from an aXe sensitivity file."""
    import fitsio

    if not path.is_file():
        raise InputError("no such file; the grating's .conf names it", file=path)
    try:
        table = fitsio.read(str(path), ext=1, upper=True)
        wave, sensitivity = (np.asarray(table[name], float) for name in ("WAVELENGTH", "SENSITIVITY"))
    except (OSError, ValueError, KeyError, IndexError, TypeError) as exc:
        why = (str(exc).strip().splitlines() or [type(exc).__name__])[-1]
        raise InputError(f"cannot be read as a sensitivity: {why}", file=path) from None
    finite = wave.ndim == 1 and len(wave) > 1 and np.isfinite(wave).all() and np.isfinite(sensitivity).all()
    if not finite or wave[0] <= 0 or (np.diff(wave) <= 0).any() or (sensitivity < 0).any():
        raise InputError("wavelengths must rise and sensitivities be 0 or more, all finite", file=path)
    throughput = on_grid(GRID, wave, sensitivity / _per_throughput(wave, telescope))
    peak = float(throughput.max())
    if not 0 < peak <= 1:
        raise InputError(
            f"impossible electrons per photon at {GRID[0]:.0f}-{GRID[-1]:.0f} A",
            file=path,
            key="SENSITIVITY",
            value=peak,
            allowed="a peak above 0, up to 1",
        )
    return throughput


def sensitivity(wavelength: FloatArray, throughput: FloatArray, telescope: Telescope) -> FloatArray:
    """Return aXe's sensitivity (n,) [e-/s/A per erg/s/cm2/A] of a throughput (n,) at wavelengths (n,) [angstrom]."""
    return throughput * _per_throughput(wavelength, telescope)


def _per_throughput(wavelength: FloatArray, telescope: Telescope) -> FloatArray:
    return _ERG_CM2 * telescope.area_m2 * wavelength / (H_J_S * C_A_S)
