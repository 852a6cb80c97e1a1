"""Configuration files of gratings in the format of grismconf, for other software that uses it.

    BEAM_+1                    an order
    DISPX_+1_i, DISPY_+1_i     dx, dy = sum_i t^i c_i(m, n)       [px from the direct image at m, n, 0-based]
    DISPL_+1_i                 lambda = sum_i t^i c_i(m, n)       [angstrom]
    SENSITIVITY_+1             table of WAVELENGTH [A] and SENSITIVITY [e-/s/A per erg/s/cm2/A]

t runs from 0 to 1 over the order's extent along x, at the centre of the grating's piece. Each c has the factors of
1, m, n, m^2, m n, n^2, as in aXe (instrument.axe). Traces are straight, so DISPX and DISPY are exact. The wavelength
has the factor sqrt(1 + a1^2) of the trace's slope, which is fitted; `write_grismconf` returns the error of the fit.
NAXIS has rows before columns, as grismconf expects. See github.com/npirzkal/GRISMCONF.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from csstsim.base.files.atomic import atomic_path
from csstsim.instrument.axe import TERMS, field_terms, sensitivity_file
from csstsim.instrument.filter import GRID
from csstsim.instrument.grating import sensitivity

if TYPE_CHECKING:
    from csstsim.base.arrays.bounds import Bounds
    from csstsim.base.types import FloatArray, PathLike
    from csstsim.instrument.chip import Chip
    from csstsim.instrument.grating import DiffractionOrder, Grating
    from csstsim.instrument.telescope import Telescope

SAMPLES = 12  # direct images along each side of a grating's piece to which the wavelength is fitted


def order_name(number: int) -> str:
    """Return grismconf's name of an order: +1, 0, -1."""
    return f"{number:+d}" if number else "0"


def write_grismconf(
    folder: PathLike, grating: Grating, bounds: Bounds, chip: Chip, telescope: Telescope
) -> tuple[list[Path], float]:
    """Write {grating}.conf and the sensitivity of each order into a folder; return (paths, maximum error [px]).

    grating: instrument.grating.Grating; bounds: of its direct images [px]; chip: instrument.chip.Chip.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    nx = chip.detector.nx
    ny = chip.detector.ny
    lines = [f"# Grating {grating.name}, of chip {chip.id}", f"NAXIS {ny} {nx}"]
    paths = []
    max_error = 0.0
    x0, x1, y0, y1 = bounds
    for number, order in grating.orders.items():
        name = order_name(number)
        file = sensitivity_file(grating.name, number)
        terms, error = dispersion(order, bounds)
        max_error = max(max_error, error)
        lines += ["", f"BEAM_{name}", f"XRANGE_{name} {x0:g} {x1 - nx:g}", f"YRANGE_{name} {y0:g} {y1 - ny:g}"]
        for key, table in terms.items():
            lines += [" ".join([f"{key}_{name}_{i}", *(f"{v:.12g}" for v in row)]) for i, row in enumerate(table)]
        lines.append(f"SENSITIVITY_{name} {file}")
        _write_sensitivity(folder / file, order, telescope)
        paths.append(folder / file)
    path = folder / f"{grating.name}.conf"
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n")
    return [path, *paths], max_error


def dispersion(order: DiffractionOrder, bounds: Bounds) -> tuple[dict[str, FloatArray], float]:
    """Return ({DISPX, DISPY, DISPL: (2, 6)}, maximum error of the wavelength [px]) of a diffraction order."""
    xoff, yoff, a0, a1, alpha0, alpha1 = order.coefficients
    centre = field_terms(0.5 * (bounds.x0 + bounds.x1), 0.5 * (bounds.y0 + bounds.y1))
    first, last = np.array(order.extent) - centre @ xoff
    along = np.zeros((2, len(TERMS)))
    ends = np.zeros((2, len(TERMS)))
    along[0] = xoff
    along[1, 0] = last - first
    along[0, 0] += first
    ends[0] = yoff + a0 + first * a1
    ends[1] = (last - first) * a1
    x, y = np.meshgrid(np.linspace(bounds.x0, bounds.x1, SAMPLES), np.linspace(bounds.y0, bounds.y1, SAMPLES))
    field = field_terms(x.ravel(), y.ravel())
    scale = np.abs(field).max(axis=0)
    per = (field @ alpha1) * np.sqrt(1 + (field @ a1) ** 2)  # angstrom per px along x
    wanted = np.stack([field @ alpha0 + first * per, (last - first) * per], axis=1)
    waves = np.linalg.lstsq(field / scale, wanted, rcond=None)[0].T / scale
    error = np.abs((wanted - field @ waves.T) @ [[1.0, 1.0], [0.0, 1.0]] / per[:, None])
    return {"DISPX": along, "DISPY": ends, "DISPL": waves}, float(error.max())


def _write_sensitivity(path: Path, order: DiffractionOrder, telescope: Telescope) -> None:
    """Write the sensitivity of an order where it is not zero, with a zero on either side."""
    from astropy.io import fits

    used = np.flatnonzero(order.throughput)
    part = slice(max(used[0] - 1, 0), min(used[-1] + 2, len(GRID)))
    wave = GRID[part]
    values = sensitivity(wave, order.throughput[part], telescope)
    columns = [fits.Column("WAVELENGTH", "D", array=wave), fits.Column("SENSITIVITY", "D", array=values)]
    with atomic_path(path) as temporary:
        fits.BinTableHDU.from_columns(columns).writeto(temporary, checksum=True)
