"""Gratings: the position and the amount of light of each order (paper, section 4.2).

A grating's numbers are those of its aXe configuration (instrument.axe). Two gratings, side by side, cover a
spectroscopic chip; light passes the one on whose side it would fall undispersed. Left out: beams that cross the line
between two gratings are not divided, and a grating's frame blocks all of a beam or nothing.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from csstsim.base.errors import InputError
from csstsim.base.model import Data, Number, Whole, between, validate
from csstsim.base.resampling import on_grid
from csstsim.base.types import FloatArray, Floats, PathLike
from csstsim.base.units import C_A_S, H_J_S
from csstsim.instrument.axe import BEAMS, COEFFICIENTS, field_range, field_terms, read_axe
from csstsim.instrument.chip import Chip
from csstsim.instrument.filter import GRID, Filter
from csstsim.instrument.telescope import Telescope

_AGREE = 0.01  # of the peak: first order's sensitivity against the filter curve, which defines magnitudes
_FAR = 20_000  # px, twice a chip: a coefficient is wrong if light lands further from its direct image
_ERG_CM2 = 1e-3  # erg / cm2 in J / m2


@dataclass(frozen=True, eq=False)
class DiffractionOrder:
    """One diffraction order of a grating."""

    number: int
    extent: tuple[float, float]  # (first, last) px along x from the direct image
    coefficients: FloatArray  # (6 coefficients, 6 terms): axe.COEFFICIENTS by axe.TERMS
    throughput: FloatArray  # on filter.GRID, electron / photon that enters the aperture

    def lines(self, x: Floats, y: Floats) -> FloatArray:
        """Return (n, 4): p, q, r, s of dx = p + q lambda, dy = r + s lambda [px from the direct image at x, y]."""
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
    """How far light lies from its direct image [px]: negative to the left and down."""

    left: float
    right: float
    down: float
    up: float


@dataclass(frozen=True, eq=False)
class Gratings:
    """The two gratings of a chip. Light that would land outside `bounds` (x0, x1, y0, y1) [px] does not pass them."""

    left: Grating
    right: Grating
    split: float  # the left grating's light falls at x < split - 0.5, that is on columns below `split`
    bounds: tuple[float, float, float, float]

    @property
    def pieces(self) -> list[tuple[Grating, tuple[float, float, float, float]]]:
        """[(grating, (x0, x1, y0, y1) of its direct images)], left, then right."""
        x0, x1, y0, y1 = self.bounds
        line = self.split - 0.5
        return [(self.left, (x0, line, y0, y1)), (self.right, (line, x1, y0, y1))]

    @property
    def numbers(self) -> list[int]:
        """Orders of either grating, rising."""
        return sorted(set(self.left.orders) | set(self.right.orders))

    def span(self, x: float, y: float) -> Span:
        """Return the Span of the zeroth and first order of an object at x, y [px]."""
        grating = self.pieces[int(x >= self.split - 0.5)][0]
        ends = [(0.0, 0.0)]
        for order in (grating.orders[number] for number in (0, 1) if number in grating.orders):
            p, q, r, s = order.lines(x, y)
            ends += [(p + q * wave, r + s * wave) for wave in order.range]
        along, across = zip(*ends, strict=True)
        return Span(min(along), max(along), min(across), max(across))

    @cached_property
    def reach(self) -> float:
        """The largest distance of light from its direct image, along x or y [px]."""
        return max(_reach(order, piece) for grating, piece in self.pieces for order in grating.orders.values())


def _reach(order: DiffractionOrder, piece: tuple[float, float, float, float]) -> float:
    x0, x1, y0, y1 = piece
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(x0, x1, 5), np.linspace(y0, y1, 5)))
    p, q, r, s = order.lines(x, y).T
    return float(max(np.abs([p + q * wave, r + s * wave]).max() for wave in order.range))


Name = Annotated[str, Field(min_length=1)]  # of a .conf file
Reach = Annotated[Number, between(0, _FAR)]


@dataclass(frozen=True, eq=False, repr=False)
class _Row(Data):
    """A chip's entry of gratings.yaml; a single grating over the whole chip is given on both sides."""

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
    """Return {chip id: Gratings} of the spectroscopic `chips` {id: Chip}; their bounds are in pixels.

    folder: that of the .conf files; data: gratings.yaml as instrument.load.read_data gives it. Raises InputError for a
    missing chip or file, traces that reverse within a piece, or sensitivities that differ from the filters'.
    """
    folder = Path(folder)
    read: dict[tuple[str, str], Grating] = {}
    out: dict[int, Gratings] = {}
    file = folder.with_name("gratings.yaml")
    rows = data.get("chips")
    if not isinstance(rows, dict):
        raise InputError("must be a mapping of chips", file=file, key="chips", value=rows)
    for number in set(rows) - set(chips):
        raise InputError("not a chip behind gratings", file=file, key="chips", value=number, allowed=sorted(chips))
    for number, chip in chips.items():
        row = validate(_Row, rows.get(number), file, ("chips", number))
        nx = chip.detector.nx
        ny = chip.detector.ny
        if row.split >= nx:
            key = f"chips.{number}.split"
            raise InputError("must be a column", file=file, key=key, value=row.split, allowed=f"1..{nx - 1}")
        for name in {(row.left, chip.filter), (row.right, chip.filter)} - set(read):
            read[name] = load_grating(folder / f"{name[0]}.conf", filters[chip.filter], telescope)
        left, right, low, high = row.reach
        bounds = -0.5 - left, nx - 0.5 + right, -0.5 - low, ny - 0.5 + high
        out[number] = Gratings(read[row.left, chip.filter], read[row.right, chip.filter], float(row.split), bounds)
        for grating, piece in out[number].pieces:
            _check_traces(grating, piece, folder / f"{grating.name}.conf")
    return out


def _check_traces(grating: Grating, piece: tuple[float, float, float, float], file: Path) -> None:
    """Raise InputError unless each order has the right sign over the whole piece and its light lands in its extent."""
    letters = {order: beam for beam, order in BEAMS.items()}
    first = 0.0
    where = "direct images at x {:g}..{:g}, y {:g}..{:g}".format(*piece)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for number in sorted(grating.orders, key=lambda k: k != 1):  # the first before the others
            key = f"DLDP_{letters[number]}_1"
            alpha1 = grating.orders[number].coefficients[list(COEFFICIENTS).index("alpha1")]
            span = field_range(alpha1, *piece)
            if not span[0] * span[1] > 0:
                raise InputError("must have one sign for " + where, file=file, key=key, value=span)
            first = first or span[0]
            if number * first * span[0] < 0:
                raise InputError(
                    f"wrong sign of order {number:+d}",
                    file=file,
                    key=key,
                    value=span,
                    allowed="beams A to E are +1, 0, +2, -1, -2",
                )
            far = _reach(grating.orders[number], piece)
            if not far < _FAR:
                raise InputError(
                    f"sends light too far for {where}",
                    file=file,
                    key=f"BEAM{letters[number]}",
                    value=far,
                    allowed=f"up to {_FAR} px",
                )
            order = grating.orders[number]
            p, q, *_ = order.lines(0.5 * (piece[0] + piece[1]), 0.5 * (piece[2] + piece[3]))
            mean = (
                GRID * order.throughput
            ).sum() / order.throughput.sum()  # no BLAS: its threads cost more than the sum
            middle = float(p + q * mean)
            if not order.extent[0] <= middle <= order.extent[1]:
                raise InputError(
                    f"the middle of the order's light lands elsewhere (is DLDP in px and angstrom?) for {where}",
                    file=file,
                    key=f"BEAM{letters[number]}",
                    value=middle,
                    allowed=f"{order.extent} px",
                )


def load_grating(path: PathLike, filter: Filter, telescope: Telescope) -> Grating:
    """Return the Grating of an aXe file: coefficients (6,), throughputs [e- / photon]. Raises InputError."""
    path = Path(path)
    orders: dict[int, DiffractionOrder] = {}
    for number, one in sorted(read_axe(path).items()):
        _check_beside(path, one["sensitivity"])
        throughput = _throughput(path.parent / one["sensitivity"], telescope)
        table = np.stack([one[name] for name in COEFFICIENTS])
        orders[number] = DiffractionOrder(number, one["extent"], table, throughput)
    worst = np.abs(orders[1].throughput - filter.throughput).max() / filter.throughput.max()
    if not worst < _AGREE:
        raise InputError(
            f"the first order's sensitivity is not the throughput of {filter.name} in filters.yaml: magnitudes would "
            "not match the light drawn",
            file=path,
            key="SENSITIVITY_A",
            value=f"off by {worst:.3f} of the peak",
            allowed=f"{_AGREE}",
        )
    return Grating(path.stem, orders)


def _check_beside(path: Path, name: str) -> None:
    """Raise InputError for a sensitivity file that the camera's digest would not know (load.data_files)."""
    file = Path(name)
    if file.is_absolute() or ".." in file.parts or file.name.startswith(".") or ".fits" not in file.suffixes:
        raise InputError(
            "a change of this file would go unnoticed",
            file=path,
            key="SENSITIVITY",
            value=name,
            allowed="a .fits file in this folder",
        )


def _throughput(path: Path, telescope: Telescope) -> FloatArray:
    """Return the electrons per photon on GRID that an aXe sensitivity file gives."""
    import fitsio

    if not path.is_file():
        raise InputError("no such file; the grating's .conf names it", file=path)
    try:
        table = fitsio.read(str(path), ext=1, upper=True)
        wave, sensitivity = (np.asarray(table[name], float) for name in ("WAVELENGTH", "SENSITIVITY"))
    except (OSError, ValueError, KeyError, IndexError, TypeError) as exc:
        why = (str(exc).strip().splitlines() or [type(exc).__name__])[-1]
        raise InputError(f"cannot be read as a sensitivity: {why}", file=path) from None
    fine = wave.ndim == 1 and len(wave) > 1 and np.isfinite(wave).all() and np.isfinite(sensitivity).all()
    if not fine or wave[0] <= 0 or (np.diff(wave) <= 0).any() or (sensitivity < 0).any():
        raise InputError("wavelengths must rise and sensitivities be 0 or more, all finite", file=path)
    throughput = on_grid(GRID, wave, sensitivity / _per_throughput(wave, telescope))
    most = float(throughput.max())
    if not 0 < most <= 1:
        raise InputError(
            f"impossible electrons per photon at {GRID[0]:.0f}-{GRID[-1]:.0f} A",
            file=path,
            key="SENSITIVITY",
            value=most,
            allowed="a peak above 0, up to 1",
        )
    return throughput


def sensitivity(wavelength: FloatArray, throughput: FloatArray, telescope: Telescope) -> FloatArray:
    """Return aXe's sensitivity [e-/s/A per erg/s/cm2/A] for a throughput at `wavelength` [angstrom]."""
    return throughput * _per_throughput(wavelength, telescope)


def _per_throughput(wavelength: FloatArray, telescope: Telescope) -> FloatArray:
    return _ERG_CM2 * telescope.area_m2 * wavelength / (H_J_S * C_A_S)
