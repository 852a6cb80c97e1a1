"""Gratings: where the light of each order goes, and how much of it (paper, section 4.2).

A grating's numbers are those of its aXe configuration (instrument.axe). Two of them, side by side, cover a
spectroscopic chip; the side on which light would fall undispersed decides which one it meets. Left out: beams that
cross the line between two gratings are not divided, and a frame takes all or nothing of a beam.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from csstsim.errors import InputError
from csstsim.instrument.axe import COEFFICIENTS, field_terms, read_axe
from csstsim.instrument.filter import GRID
from csstsim.units import C_A_S, H_J_S

_AGREE = 0.01  # of the peak: first order's sensitivity against the filter curve, which magnitudes rest on
_ERG_CM2 = 1e-3  # erg / cm2 in J / m2


@dataclass(frozen=True, eq=False)
class Order:
    """One diffraction order of a grating."""

    number: int
    extent: tuple  # (first, last) px along x from the direct image
    coefficients: np.ndarray  # (6 coefficients, 6 terms): axe.COEFFICIENTS by axe.TERMS
    throughput: np.ndarray  # on filter.GRID, electron / photon that enters the aperture

    def lines(self, x, y):
        """Return (n, 4): p, q, r, s of dx = p + q lambda, dy = r + s lambda [px from the direct image at x, y]."""
        xoff, yoff, a0, a1, alpha0, alpha1 = np.einsum("ck,...k->c...", self.coefficients, field_terms(x, y))
        q = 1.0 / (alpha1 * np.sqrt(1.0 + a1 * a1))
        p = xoff - alpha0 * q
        return np.stack([p, q, yoff + a0 + a1 * (p - xoff), a1 * q], axis=-1)

    def coefficients_at(self, x, y):
        """Return {name: array} of the trace's coefficients (axe.COEFFICIENTS) at direct images x, y [0-based px]."""
        values = np.einsum("ck,...k->c...", self.coefficients, field_terms(x, y))
        return dict(zip(COEFFICIENTS, values, strict=True))

    @property
    def range(self):
        """(first, last) wavelength [angstrom] that the order passes."""
        used = np.flatnonzero(self.throughput)
        return float(GRID[used[0]]), float(GRID[used[-1]])


@dataclass(frozen=True, eq=False)
class Grating:
    """One grating; `orders` {number: Order}, rising."""

    name: str
    orders: dict


@dataclass(frozen=True, eq=False)
class Gratings:
    """The two gratings of a chip. `bounds` (x0, x1, y0, y1) [px]: light that would land beyond does not meet them."""

    left: Grating
    right: Grating
    split: float  # the left grating's light falls at x < split - 0.5, that is on columns below `split`
    bounds: tuple

    @property
    def pieces(self):
        """[(grating, (x0, x1, y0, y1) of the direct images it serves)], left, then right."""
        x0, x1, y0, y1 = self.bounds
        line = self.split - 0.5
        return [(self.left, (x0, line, y0, y1)), (self.right, (line, x1, y0, y1))]

    @property
    def numbers(self):
        """Orders of either grating, rising."""
        return sorted(set(self.left.orders) | set(self.right.orders))

    @cached_property
    def reach(self):
        """How far from its direct image light may land, along x or y [px]."""
        x0, x1, y0, y1 = self.bounds
        x, y = (v.ravel() for v in np.meshgrid(np.linspace(x0, x1, 5), np.linspace(y0, y1, 5)))
        far = 0.0
        for order in (order for grating, _ in self.pieces for order in grating.orders.values()):
            p, q, r, s = order.lines(x, y).T
            far = max(far, *(np.abs([p + q * wave, r + s * wave]).max() for wave in order.range))
        return float(far)


def load_gratings(folder, data, chips, filters, telescope):
    """Return {chip id: Gratings} of the spectroscopic `chips` {id: Chip}.

    folder: of the .conf files; data: gratings.yaml as instrument.load.read_data gives it. Raises InputError for a
    missing chip or file, or sensitivities that are not those of the filter curves.
    """
    file, read, out = Path(folder).with_name("gratings.yaml"), {}, {}
    rows = data.get("chips")
    for number, chip in chips.items():
        row, key = rows.get(number) if isinstance(rows, dict) else None, f"chips.{number}"
        bounds = _bounds(row, chip, file, key)
        for name in {row["left"], row["right"]} - set(read):
            read[name] = load_grating(Path(folder) / f"{name}.conf", filters[chip.filter], telescope)
        out[number] = Gratings(read[row["left"]], read[row["right"]], float(row["split"]), bounds)
    return out


def _bounds(row, chip, file, key):
    keys = {"left", "right", "split", "reach"}
    if not isinstance(row, dict) or set(row) != keys:
        raise InputError("two gratings are needed", file=file, key=key, value=row, allowed=", ".join(sorted(keys)))
    nx, ny, reach = chip.detector.nx, chip.detector.ny, row["reach"]
    good = isinstance(reach, list) and len(reach) == 4 and all(isinstance(v, int | float) and v >= 0 for v in reach)
    if not good:
        raise InputError("must be four lengths [px]", file=file, key=f"{key}.reach", value=reach)
    if not (isinstance(row["split"], int) and 0 < row["split"] < nx):
        raise InputError("must be a column", file=file, key=f"{key}.split", value=row["split"], allowed=f"1..{nx - 1}")
    return -0.5 - reach[0], nx - 0.5 + reach[1], -0.5 - reach[2], ny - 0.5 + reach[3]


def load_grating(path, filter, telescope):
    """Return the Grating of an aXe configuration file. Raises InputError."""
    path, orders = Path(path), {}
    for number, one in sorted(read_axe(path).items()):
        throughput = _throughput(path.with_name(one["sensitivity"]), telescope)
        table = np.stack([one[name] for name in COEFFICIENTS])
        orders[number] = Order(number, one["extent"], table, throughput)
    worst = np.abs(orders[1].throughput - filter.throughput).max() / filter.throughput.max()
    if not worst < _AGREE:
        raise InputError(
            f"the first order's sensitivity is not the throughput of {filter.name} in filters.yaml: magnitudes would "
            "not be those of the light drawn", file=path, key="SENSITIVITY_A", value=f"off by {worst:.3f} of the peak",
            allowed=f"{_AGREE}",
        )  # fmt: skip
    return Grating(path.stem, orders)


def _throughput(path, telescope):
    """Return electrons per photon on GRID of an aXe sensitivity file."""
    import fitsio

    try:
        table = fitsio.read(str(path), ext=1)
        wave, sensitivity = (np.asarray(table[name], float) for name in ("WAVELENGTH", "SENSITIVITY"))
    except (OSError, ValueError, KeyError) as exc:
        raise InputError(f"cannot be read as a sensitivity: {str(exc).strip().splitlines()[-1]}", file=path) from None
    fine = len(wave) > 1 and (np.diff(wave) > 0).all() and (sensitivity >= 0).all() and np.isfinite(sensitivity).all()
    if not fine or not (sensitivity > 0).any():
        raise InputError("wavelengths must rise and sensitivities be 0 or more, not all 0", file=path)
    return np.interp(GRID, wave, sensitivity / _per_throughput(wave, telescope), left=0.0, right=0.0)


def sensitivity(wavelength, throughput, telescope):
    """Return aXe's sensitivity [e-/s/A per erg/s/cm2/A] of a throughput at `wavelength` [angstrom]."""
    return throughput * _per_throughput(wavelength, telescope)


def _per_throughput(wavelength, telescope):
    return _ERG_CM2 * telescope.area_m2 * wavelength / (H_J_S * C_A_S)
