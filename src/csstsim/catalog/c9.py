"""Input catalogues in the HDF5 form of Cycle 9 (facts: catalog.c9_files), as a CatalogBase.

In a campaign: `catalog: {kind: "csstsim.catalog.c9:C9Catalog", options: {stars: ..., galaxies: ..., basis: ...}}`.

    stars      the embedded atmospheres at (Teff, log g, [Fe/H]), dimmed by A(V), with AB app_sdss_g in SDSS g
    galaxies   max(0, sum_k coeff_k B_k(lambda / (1 + z))) as f_lambda, with AB mag_csst_i in CSST's i
    quasars    row `qsoindex` of a table of observed f_lambda; each is an object in addition to its galaxy

The files' layout is public (sources: c9_files). Public, too, are two meanings of z_met, and two epochs of positions:
the converter of Gaia's catalogue writes positions of 2016 without conversion. Both are options. A parallax of 0 or
below, as that converter writes, counts as unknown.

Assumed, because no public text states it: app_sdss_g is as observed, with dust; `size` is a half-light radius (a public
script uses it as about that) of both bulge and disk; the bulge's fraction of the flux is its fraction of the mass;
`shear` is gamma; ellipticity and shear have csstsim's axes; magnitudes are before magnification; the names in the files
of `basis` and `quasars`. Omitted: dust and intergalactic absorption in galaxies' spectra, except what their magnitudes
contain.
"""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.resampling import on_grid
from csstsim.base.shipped import SHIPPED
from csstsim.base.units import C_A_S, H_J_S
from csstsim.catalog.astrometry.reduction import moved
from csstsim.catalog.base import CatalogBase, Region
from csstsim.catalog.c9_files import BANDS, read_array, read_galaxies, read_stars
from csstsim.catalog.light.embedded_spectra import coefficients
from csstsim.catalog.light.photometry import ab_mag
from csstsim.catalog.mock_object import MockObject, MockObjects
from csstsim.catalog.table import GALAXY, QUASAR, STAR, ObjectTable
from csstsim.instrument.camera import load_camera
from csstsim.instrument.filter import GRID
from csstsim.universe.coefficients import COEFFICIENTS
from csstsim.universe.parameters import Universe, load_universe

if TYPE_CHECKING:
    from collections.abc import Mapping

    from astropy.table import Table
    from numpy.typing import ArrayLike

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray, PathLike

OPTIONS = (
    "stars", "galaxies", "basis", "quasars", "partial", "metallicity", "solar_z", "epoch", "universe", "instrument",
)  # fmt: skip
EPOCHS = 1900.0, 2100.0
NORM_BAND = "i"
_PER_ERG = 1e-3 / (H_J_S * C_A_S)  # erg / s / cm2 / A times lambda [A] to photon / s / m2 / A


class C9Catalog(CatalogBase):
    """Stars, galaxies and quasars of a region.

    options:
        stars        an HDF5 file, or a list of them
        galaxies     folder of the bundles
        basis        HDF5 file with `wavelength` (n,) [A, rest] and `components` (20, n) f_lambda; needed for galaxies
        quasars      HDF5 file with `wavelength` (n,) [A, observed] and `flux` (m, n) [erg / s / cm2 / A];
                     null omits quasars
        partial      true: a missing bundle is empty sky [false: an error]
        metallicity  the meaning of z_met: "mass_fraction" (of the official files) or "dex"
        solar_z      mass fraction of the Sun, for "mass_fraction" [0.02, as in the public converter]
        epoch        Julian year of the stars' positions [2000.0]; 2016.0 for files from Gaia's third release
        universe, instrument   folders of the spectra and of the camera [the shipped ones]

    Raises InputError for a missing or unknown option, file, dataset or shape.
    """

    PATHS: ClassVar[tuple[str, ...]] = ("stars", "galaxies", "basis", "quasars", "universe", "instrument")

    def __init__(self, options: Mapping[str, Any], region: Region) -> None:
        super().__init__(options, region)
        for name in set(self.options) - set(OPTIONS):
            raise InputError("unknown key", key="catalog.options", value=name, allowed=", ".join(OPTIONS))
        if not (self.options.get("stars") or self.options.get("galaxies")):
            raise InputError("give stars, galaxies or both", key="catalog.options")
        kinds = ("mass_fraction", "dex")
        if self.options.get("metallicity", kinds[0]) not in kinds:
            value = self.options["metallicity"]
            raise InputError("unknown", key="catalog.options.metallicity", value=value, allowed=", ".join(kinds))
        epoch = self.options.get("epoch", 2000.0)
        if isinstance(epoch, bool) or not isinstance(epoch, int | float) or not EPOCHS[0] <= epoch <= EPOCHS[1]:
            allowed = f"Julian years, {EPOCHS[0]:g} to {EPOCHS[1]:g}"
            raise InputError("not an epoch", key="catalog.options.epoch", value=epoch, allowed=allowed)
        self._load()

    def _load(self) -> None:
        files = self.options.get("stars") or []
        folder = self.options.get("galaxies")
        bricks = self.region.bricks
        parts = [_complete({"id": np.zeros(0, np.int64)})]
        rows_read: dict[int, int] = {}
        for pixel, columns in read_stars([files] if isinstance(files, str | Path) else files, bricks):
            first = rows_read.get(pixel, 0)
            rows_read[pixel] = first + len(columns["RA"])
            parts.append(self._stars(columns, _ids(pixel, first, len(columns["RA"]), STAR)))
        for pixel, columns in read_galaxies(folder, bricks, self.options.get("partial", False)) if folder else ():
            host = _ids(pixel, 0, len(columns["ra"]), GALAXY)
            parts.append(_galaxies(columns, host))
            active = columns["qsoindex"] >= 0
            if active.any() and self._quasar_file:
                parts.append(_quasars(columns, host, active))
        self._table = ObjectTable.concat(parts or [_complete({})])
        self.objs = MockObjects(self._table)  # type: ignore[assignment] # like a list; objects are created on access

    def _stars(self, columns: Mapping[str, AnyArray], ids: IntArray) -> ObjectTable:
        with np.errstate(invalid="ignore"):
            metals = columns["z_met"]
            if self.options.get("metallicity") != "dex":
                metals = np.log10(np.maximum(metals, 1e-9) / self.options.get("solar_z", 0.02))
        names = {"pmra": "pmra", "pmdec": "pmdec", "rv": "RV", "parallax": "parallax", "ra": "RA", "dec": "DEC",
                 "logg": "grav", "av": "AV", "stellarmass": "mass", "mag_norm": "app_sdss_g"}  # fmt: skip
        given = {ours: columns[theirs] for ours, theirs in names.items() if theirs in columns}
        given |= self._j2000_positions(given)
        derived: dict[str, ArrayLike] = {"id": ids, "obj_type": STAR, "teff": 10.0 ** columns["teff"], "feh": metals}
        return _complete(derived | given)

    def _j2000_positions(self, star: Mapping[str, AnyArray]) -> dict[str, AnyArray]:
        """Return ra, dec [deg] at J2000 of stars with positions of another epoch; {} if they are of J2000."""
        years = 2000.0 - self.options.get("epoch", 2000.0)
        if years == 0 or not {"pmra", "pmdec"} <= set(star):
            return {}
        ra, dec = moved(star["ra"], star["dec"], star["pmra"], star["pmdec"], years)
        return {"ra": ra, "dec": dec}

    @cached_property
    def _universe(self) -> Universe:
        return load_universe(self.options.get("universe") or SHIPPED / "universe")

    @cached_property
    def _curves(self) -> dict[int, FloatArray]:
        """{type: response on GRID} that mag_norm of stars and galaxies refers to."""
        from astropy.table import Table

        sdss_g = Table.read(SHIPPED / "curves" / "sdss2010_g.csv", format="ascii.csv", comment="#")
        camera = load_camera(self.options.get("instrument"))
        response = on_grid(GRID, sdss_g["wavelength"], sdss_g["response"])
        return {STAR: response, GALAXY: camera.filters[NORM_BAND].at(GRID)}

    @cached_property
    def _basis(self) -> tuple[FloatArray, FloatArray]:
        """Rest wavelengths (n,) and components (20, n) of the galaxies' spectra."""
        if not self.options.get("basis"):
            raise InputError("required key is missing: galaxies need it", key="catalog.options.basis")
        return _spectra_file(self.options["basis"], "components", COEFFICIENTS)

    @property
    def _quasar_file(self) -> PathLike | None:
        if "quasars" not in self.options:
            raise InputError(
                "required key is missing: the galaxies have quasars",
                key="catalog.options.quasars",
                allowed="a file, or null to omit them",
            )
        return self.options["quasars"]

    @cached_property
    def _quasar_spectra(self) -> tuple[FloatArray, FloatArray]:
        """Observed wavelengths (n,) and f_lambda (m, n) of the quasars."""
        assert self._quasar_file is not None  # given with quasars
        return _spectra_file(self._quasar_file, "flux")

    def load_sed(self, obj: MockObject) -> Table:
        """Return the spectrum of one object before normalisation: Table of WAVELENGTH [A] and FLUX."""
        from astropy.table import Table

        row = ObjectTable({name: [value] for name, value in obj.values.items()})
        return Table({"WAVELENGTH": GRID, "FLUX": self._shapes(row)[0]})

    def load_norm_filt(self, obj: MockObject) -> Table | None:
        """Return SDSS g for a star, CSST's i for a galaxy, None for a quasar: Table of WAVELENGTH and SENSITIVITY."""
        from astropy.table import Table

        if obj.obj_type == QUASAR:
            return None
        return Table({"WAVELENGTH": GRID, "SENSITIVITY": self._curves[int(obj.obj_type)]})

    def load_seds(self, rows: IntArray) -> FloatArray:
        """Return (len(rows), 18001) spectra [photon / s / m2 / A] on the paper's grid; NaN for unusable parameters."""
        table = self._table.take(np.asarray(rows, dtype=int))
        seds = self._shapes(table)
        for kind, curve in self._curves.items():
            some = np.flatnonzero(table["obj_type"] == kind)
            with np.errstate(invalid="ignore", over="ignore"):
                excess = ab_mag(seds[some], GRID, curve) - table["mag_norm"][some]
                seds[some] *= 10 ** (0.4 * excess)[:, None]
        return seds

    def _shapes(self, table: ObjectTable) -> FloatArray:
        """Return (n, 18001) photon densities, those of stars and galaxies up to a factor."""
        out = np.full((len(table), len(GRID)), np.nan)
        star = (table["obj_type"] == STAR) & np.isfinite(table["teff"] + table["logg"] + table["feh"] + table["av"])
        if star.any():
            some = table.take(star)
            surface = self._universe.star_seds.surface(some["teff"], some["logg"], some["feh"])
            out[star] = surface * 10 ** (-0.4 * some["av"].astype(float)[:, None] * self._universe.extinction)
        mix = coefficients(table).astype(float)
        for row in np.flatnonzero(table["obj_type"] == GALAXY):
            wave, basis = self._basis
            flux = np.maximum(np.einsum("k,kw->w", mix[row], basis), 0.0)
            out[row] = on_grid(GRID, wave * (1.0 + table["z"][row]), flux) * GRID
        for row in np.flatnonzero(table["obj_type"] == QUASAR):
            wave, flux = self._quasar_spectra
            index = table["qsoindex"][row]
            if index >= len(flux):
                raise InputError(
                    "has too few rows", file=self._quasar_file, key="flux", value=flux.shape, allowed=f"row {index}"
                )
            out[row] = on_grid(GRID, wave, flux[index]) * GRID * _PER_ERG
        return out


def _galaxies(columns: Mapping[str, AnyArray], ids: IntArray) -> ObjectTable:
    bulge, disk = (columns[name].astype(float) for name in ("bulgemass", "diskmass"))
    with np.errstate(invalid="ignore"):
        bulge_frac = bulge / (bulge + disk)
    (e1, e2), (gamma1, gamma2) = columns["ellipticity_true"].T, columns["shear"].T
    return _complete(
        {"id": ids, "obj_type": GALAXY, "ra": columns["ra"], "dec": columns["dec"], "z": columns["redshift"],
         "size_disk": columns["size"], "size_bulge": columns["size"], "bulge_frac": bulge_frac, "e1": e1, "e2": e2,
         "kappa": columns["kappa"], "gamma1": gamma1, "gamma2": gamma2, "bulgemass": bulge, "diskmass": disk,
         "veldisp": columns["veldisp"], "gal_type": columns["type"], "mag_norm": columns[f"mag_csst_{NORM_BAND}"],
         **{f"mag_{band}": columns[f"mag_csst_{band}"] for band in BANDS},
         **{f"coeff{k}": columns["coeff"][:, k] for k in range(COEFFICIENTS)}}
    )  # fmt: skip


def _quasars(columns: Mapping[str, AnyArray], host: IntArray, active: BoolArray) -> ObjectTable:
    shear = columns["shear"][active].T
    return _complete(
        {"id": host[active] - GALAXY + QUASAR, "obj_type": QUASAR, "ra": columns["ra"][active],
         "dec": columns["dec"][active], "z": columns["redshift"][active], "kappa": columns["kappa"][active],
         "gamma1": shear[0], "gamma2": shear[1], "host": host[active], "qsoindex": columns["qsoindex"][active]}
    )  # fmt: skip


def _complete(columns: Mapping[str, ArrayLike]) -> ObjectTable:
    """Return the ObjectTable of one kind of object, defaults in the columns of other kinds; magnitudes are CSST's."""
    extras: dict[str, np.generic] = {"mag_norm": np.float32(np.nan), "qsoindex": np.int64(-1)}
    extras |= {f"coeff{k}": np.float32(0.0) for k in range(COEFFICIENTS)}
    full = {name: np.asarray(columns.get(name, default), default.dtype) for name, default in extras.items()}
    return ObjectTable.complete({**columns, **full}, BANDS)


def _ids(pixel: int, first: int, count: int, kind: int) -> IntArray:
    """Return ids unique to pixel, row and kind: pixel x 2^32 + 4 row + kind."""
    return (np.int64(pixel) << 32) + 4 * (first + np.arange(count, dtype=np.int64)) + kind


def _spectra_file(file: PathLike, name: str, rows: int | None = None) -> tuple[FloatArray, FloatArray]:
    """Return `wavelength` (n,) and dataset `name` (rows, n) of an HDF5 file."""
    wave = read_array(file, "wavelength", 1)
    values = read_array(file, name, 2)
    if len(wave) < 2 or not (np.diff(wave) > 0).all():
        raise InputError("must rise", file=file, key="wavelength")
    if values.shape[1] != len(wave) or rows not in (None, len(values)):
        allowed = f"{rows or 'any number'} x {len(wave)}"
        raise InputError("wrong shape", file=file, key=name, value=values.shape, allowed=allowed)
    return wave, values
