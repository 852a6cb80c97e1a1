"""CatalogBase: the interface between any True Universe and the simulator (paper, section 3 and Appendix A).

Your own catalogue is one class with the paper's four methods, of which the last is optional. Its module is on the
Python path, and the campaign names it (`catalog: {kind: "mine:Mine", options: {...}}`). A complete example:

    import numpy as np
    from astropy.table import Table
    from csstsim.catalog.base import CatalogBase
    from csstsim.catalog.mock_object import MockObject

    class Mine(CatalogBase):
        def __init__(self, options, region):   # options: campaign.catalog.options; region: a Region
            super().__init__(options, region)
            self._load()
        def _load(self):                       # fill self.objs
            self.objs.append(MockObject(id=1, type="star", ra=10.0, dec=-2.0, mag_norm=18.0))
            self.objs.append(MockObject(id=2, type="galaxy", ra=10.01, dec=-2.0, mag_norm=20.0, z=0.3,
                                        size_disk=0.6, size_bulge=0.2, bulge_frac=0.3, e1=0.1, e2=-0.2))
        def load_sed(self, obj):               # as observed; here flat in photons
            wave = np.linspace(2000.0, 11000.0, 1801)
            return Table({"WAVELENGTH": wave, "FLUX": np.ones_like(wave)})
        def load_norm_filt(self, obj):         # mag_norm is AB in this box; leave it out where FLUX is absolute
            return Table({"WAVELENGTH": [5499.0, 5500.0, 7000.0, 7001.0], "SENSITIVITY": [0.0, 1.0, 1.0, 0.0]})

Keywords of a MockObject (all but id, ra, dec have defaults; the full list is `catalog.table.COLUMNS`):

| keyword                     | unit, meaning                                                                      |
|-----------------------------|------------------------------------------------------------------------------------|
| id                          | whole number below 2^63, different for each object                                 |
| type                        | "star", "galaxy" or "quasar"; stars and quasars are points                         |
| ra, dec                     | deg, ICRS at J2000                                                                 |
| pmra, pmdec, parallax, rv   | mas/yr (pmra with cos dec), mas, km/s: stars only                                  |
| size_disk, size_bulge       | arcsec, half-light radius along the circle of equal area; a galaxy needs the size  |
|                             | of each component with flux                                                        |
| bulge_frac                  | fraction of the flux in the bulge (Sersic 4); the rest is disk (Sersic 1)          |
| n_disk, n_bulge             | Sersic index of each, 0.3 to 6.2, if it is another one                             |
| knots, knots_frac           | number of knots in the disk, and their fraction of the flux                        |
| image_file, image_scale,    | file of an image in place of disk and bulge, arcsec per pixel, and the angle       |
| image_pa                    | [deg] by which it is turned (docs/galaxy_shapes.md)                                |
| (method galsim_object)      | a GalSim object in place of disk and bulge                                         |
| part_of                     | id of the object that this one is a part of, for the truth and validation          |
| e1, e2                      | ellipticity (a - b)/(a + b), axis 1 along +RA (east), 2 towards north              |
| kappa, gamma1, gamma2       | lensing, same axes; stars are not lensed                                           |
| mag_norm                    | AB magnitude in the filter of `load_norm_filt`, if there is one                    |
| rate_ra, rate_dec,          | arcsec/hour (rate_ra with cos dec): motion on the sky as seen from the telescope,  |
| rate_mjd, trail_width       | MJD (UTC) at which it is at ra, dec; arcsec, width of a satellite's track          |
| var_period, var_amplitude,  | day, mag, turns at MJD 0: a sine about the given magnitude                         |
| var_phase                   |                                                                                    |
| z, av, teff, logg, feh, ... | for the truth table only: csstsim renders the spectrum of `load_sed`               |
| any other name              | for use in your `load_sed`; plain values go to the truth table as `user_<name>`;   |
|                             | a galaxy's n, q, pa, re and the like are refused                                  |

WAVELENGTH is in angstrom and rises, FLUX in photon / s / m2 / angstrom; columns with astropy units are converted.
Between samples a spectrum is linear, outside them zero. It is in the observed frame: it includes redshift, dust and
Milky Way extinction, but not lensing magnification, which csstsim applies from kappa and gamma. `csstsim check` tests
the catalogue on the campaign's first exposure and lists its faults (catalog.contract).

Speed: a catalogue with many objects overrides `load_seds`, or `load_fluxes` to skip spectra altogether.
"""

from __future__ import annotations

import hashlib
import inspect
import traceback
from abc import ABC, abstractmethod
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from csstsim.base.digest import digest
from csstsim.base.errors import CsstsimError, InputError
from csstsim.base.help_page import explained
from csstsim.base.resampling import on_grid
from csstsim.base.sphere import inside_polygon, unit_vectors
from csstsim.catalog.changing import columns as changing
from csstsim.catalog.galaxy_shapes.galsim_images import galsim_columns
from csstsim.catalog.galaxy_shapes.unsupported_shapes import check_shapes
from csstsim.catalog.light.photometry import ab_mag, bin_means, load_fluxes
from csstsim.catalog.light.spectrum_tables import read_columns
from csstsim.catalog.mock_object import MockObject
from csstsim.catalog.row_files import with_images
from csstsim.catalog.table import OPTIONAL, STAR, ObjectTable, columns_with
from csstsim.instrument.filter import GRID, Filter

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from astropy.table import Table
    from galsim import GSObject

    from csstsim.base.types import AnyArray, BoolArray, FloatArray, IntArray, PathLike
    from csstsim.catalog.changing.motion import Interval
    from csstsim.instrument.telescope import Telescope


@dataclass(frozen=True)
class Region:
    """The region of the sky that a catalogue must cover.

    The region includes a margin: stars may have moved 147 arcsec since J2000. A catalogue must add faster stars that
    come from outside.

    Parameters
    ----------
    ra, dec : tuple of float
        Corners [deg, ICRS], which bound a convex polygon.
    bricks : tuple of int
        Nested HEALPix pixels of NSIDE 256 that overlap the region.
    bands : tuple of str
        Bands of the camera (Camera.bands); a table has a magnitude for each.
    """

    ra: tuple[float, ...]
    dec: tuple[float, ...]
    bricks: tuple[int, ...]
    bands: tuple[str, ...] = ()

    def contains(self, ra: FloatArray, dec: FloatArray) -> BoolArray:
        """Return which positions lie inside the corners.

        Parameters
        ----------
        ra, dec : (n,) array of float
            Positions [deg, ICRS].

        Returns
        -------
        (n,) array of bool
            True inside.

        Examples
        --------
        >>> import numpy as np
        >>> from csstsim.catalog.contract import sky_region
        >>> region = sky_region(ra=10.0, dec=-2.0, radius=0.1)
        >>> region.contains(np.array([10.0, 10.3]), np.array([-2.0, -2.0])).tolist()
        [True, False]
        """
        return inside_polygon(unit_vectors(ra, dec), unit_vectors(np.array(self.ra), np.array(self.dec)))


class CatalogBase(ABC):
    """Objects of a region of the sky and their spectra.

    A subclass names in PATHS the options that are files or folders, or lists of them. Relative ones start in the folder
    of the campaign file.

    Parameters
    ----------
    options : mapping
        catalog.options of the campaign file.
    region : Region
        The region of the sky that the catalogue must cover.
    """

    PATHS: ClassVar[tuple[str, ...]] = ()
    _table: ObjectTable

    def __init__(self, options: Mapping[str, Any], region: Region) -> None:
        self.options = dict(options)
        self.region = region
        self.objs: list[MockObject] = []

    @abstractmethod
    def _load(self) -> None:
        """Fill `self.objs` with the MockObjects of `self.region`. More are allowed: selection is by position."""

    @abstractmethod
    def load_sed(self, obj: MockObject) -> Table:
        """Return the observed spectrum of one object.

        Parameters
        ----------
        obj : MockObject
            One of `objs`.

        Returns
        -------
        Table
            Astropy Table with WAVELENGTH [angstrom], rising within 2000-11000, and FLUX [photon / s / m2 / angstrom].
        """

    def load_norm_filt(self, obj: MockObject) -> Table | None:
        """Return the filter in which the spectrum of an object has the AB magnitude `obj.mag_norm`.

        A class whose spectra are absolute omits this method (paper, Appendix A: "if applicable").

        Parameters
        ----------
        obj : MockObject
            One of `objs`.

        Returns
        -------
        Table or None
            Astropy Table with WAVELENGTH [angstrom] and SENSITIVITY; None for a spectrum that is absolute.
        """
        return None

    def galsim_object(self, obj: MockObject) -> GSObject | None:
        """Return the GalSim object with which a galaxy is rendered.

        It becomes an image (catalog.galaxy_shapes.galsim_images) in the folder of the option `images`, by default
        `galsim_images` next to the class's module.

        Parameters
        ----------
        obj : MockObject
            One of `objs`.

        Returns
        -------
        galsim.GSObject or None
            x points east and y north, in arcsec; None for a galaxy with disk and bulge.
        """
        return None

    def _galsim_objects(self) -> Iterator[tuple[str, GSObject | None]]:
        """Yield (name for messages, galsim_object) of each of `objs`."""
        for obj in self.objs:
            where = f"{name_of(self)}.galsim_object, object {obj.id}"
            with users_code(where):
                profile = self.galsim_object(obj)
            yield where, profile

    @classmethod
    def files(cls, options: Mapping[str, Any]) -> Sequence[PathLike]:
        """Return the files that determine the chips, so that a change of one simulates them again.

        Each is read completely whenever a campaign is opened; omit files that are too large for that.

        Parameters
        ----------
        options : mapping
            catalog.options of the campaign file.

        Returns
        -------
        sequence of str or Path
            Paths of the files.
        """
        return ()

    @property
    def table(self) -> ObjectTable:
        """The objects as an ObjectTable in the order of `self.objs`, in the units of its columns.

        Raises
        ------
        InputError
            If `objs` is no list, or an item of it no MockObject, or for an image that cannot be rendered.
        """
        if getattr(self, "_table", None) is None:
            if not hasattr(self.objs, "__len__"):  # None, or an iterator
                raise InputError("objs is not a list of MockObjects", key=name_of(self), value=f"{self.objs}")
            strange = [obj for obj in self.objs if not isinstance(obj, MockObject)]
            if strange:
                raise InputError("objs contains an item that is not a MockObject", key=name_of(self), value=strange[0])
            names = sorted({name for obj in self.objs for name in obj.values})
            columns: dict[str, list[Any]] = {name: [getattr(obj, name, None) for obj in self.objs] for name in names}
            if type(self).galsim_object is not CatalogBase.galsim_object:
                folder = self.options.get("images") or Path(inspect.getfile(type(self))).parent / "galsim_images"
                columns |= galsim_columns(self._galsim_objects(), columns, folder)
            bands = self.region.bands
            ours = columns_with(bands) | OPTIONAL
            for name in ours.keys() & columns.keys():
                if arrays := [value for value in columns[name] if np.ndim(value)]:
                    raise InputError("is not one value", key=f"{name_of(self)}, {name}", value=arrays[0])
            _refuse_units(name_of(self), {name: columns[name] for name in columns if name in ours})
            check_shapes(columns, columns.get("obj_type", ()), name_of(self))
            # Other values may be anything (a file name, an array); only plain ones go to the table, as user_<name>.
            timed = {name: column for name, column in columns.items() if name in changing.COLUMNS}
            extras = {f"user_{n}": column for n, column in columns.items() if n not in ours and n not in timed}
            plain = {name: _plain_column(column) for name, column in extras.items()}
            known: dict[str, list[Any] | AnyArray] = {n: column for n, column in columns.items() if n in ours}
            if "image_file" in known:
                kinds = np.asarray(columns.get("obj_type", np.full(len(self.objs), STAR)))
                known |= with_images(known, kinds, name_of(self))
            known |= {n: v for n, v in plain.items() if v is not None} | _timed(timed, len(self.objs))
            self._table = ObjectTable.complete(known, bands)
        return self._table

    @property
    def truth_hash(self) -> str:
        """16 hexadecimal digits of the options and the columns of `table` (spectra do not enter)."""
        total = hashlib.sha256(digest(self.options).encode())
        for name in self.table:
            total.update(name.encode() + self.table[name].tobytes())
        return total.hexdigest()[:16]

    def load_seds(self, rows: IntArray) -> FloatArray:
        """Return spectra of rows of `table` on the paper's grid, 2000-11000 angstrom by 0.5 angstrom.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.

        Returns
        -------
        (n, 18001) array of float
            Spectra [photon / s / m2 / angstrom].

        Raises
        ------
        InputError
            If `load_sed` or `load_norm_filt` raises an exception or returns the wrong form.
        """
        return np.array([self._load_on_grid(self.objs[row]) for row in rows]).reshape(len(rows), len(GRID))

    def load_fluxes(self, rows: IntArray, filter: Filter, telescope: Telescope) -> FloatArray:
        """Return the flux of rows of `table` in a filter, before lensing magnification.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.
        filter : Filter
            A filter of the camera.
        telescope : Telescope
            The camera's telescope.

        Returns
        -------
        (n, 4) array of float
            Flux in each sub-band [electron / s].
        """
        return load_fluxes(self.load_seds, rows, filter, telescope)

    def load_binned(self, rows: IntArray, edges: FloatArray) -> FloatArray:
        """Return mean spectra of rows of `table` in bins of wavelength, made from `load_seds`.

        Slitless spectra are rendered from these means.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.
        edges : (m + 1,) array of float
            Edges of the bins [angstrom], samples of the paper's grid.

        Returns
        -------
        (n, m) array of float
            Means [photon / s / m2 / angstrom].
        """
        at = np.searchsorted(GRID, edges)
        seds = np.asarray(self.load_seds(rows), dtype=float)[:, at[0] : at[-1] + 1]
        return bin_means(seds, at - at[0])

    def rate_bound(self, rows: IntArray, filter: Filter, telescope: Telescope) -> FloatArray | None:
        """Return an upper limit of `load_fluxes`, which is then not called for objects that cannot reach a chip.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.
        filter : Filter
            A filter of the camera.
        telescope : Telescope
            The camera's telescope.

        Returns
        -------
        (n,) array of float or None
            Upper limit of the sum of the sub-bands [electron / s]; None if it is not known.
        """
        return None

    def component_shares(self, rows: IntArray, filter: Filter) -> dict[str, FloatArray] | None:
        """Return the fractions of components in a filter, for galaxies with a colour gradient on imaging chips.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.
        filter : Filter
            A filter of the camera.

        Returns
        -------
        dict or None
            {"bulge_frac": (n,) array, "knots_frac": (n,) array}, 0 to 1; None if the fractions are those of the table.
        """
        return None

    def dimming(self, rows: IntArray, interval: Interval, filter: Filter) -> FloatArray | None:
        """Return by how much objects are fainter in an exposure than the catalogue says.

        Here these are the periodic changes of the table's columns var_period, var_amplitude and var_phase. Override it
        for light curves of your own.

        Parameters
        ----------
        rows : (n,) array of int
            Row numbers.
        interval : catalog.changing.motion.Interval
            Time of the exposure.
        filter : Filter
            A filter of the camera.

        Returns
        -------
        (n,) array of float or None
            Dimming [mag]; None if nothing varies.
        """
        from csstsim.catalog.changing.light_curves import dimming

        return dimming(self.table, np.asarray(rows, dtype=int), interval, filter)

    def _load_on_grid(self, obj: MockObject) -> FloatArray:
        with users_code(f"{name_of(self)}.load_sed, object {obj.id}"):
            table = self.load_sed(obj)
        wave, flux = read_columns(table, "FLUX", f"{name_of(self)}.load_sed, object {obj.id}")
        sed = flux if np.array_equal(wave, GRID) else on_grid(GRID, wave, flux)
        where = f"{name_of(self)}.load_norm_filt, object {obj.id}"
        with users_code(where):
            norm = self.load_norm_filt(obj)
        if norm is None:
            return sed
        wave, response = read_columns(norm, "SENSITIVITY", where)
        target = getattr(obj, "mag_norm", None)
        if target is None:
            raise InputError("returned a filter, but the object has no mag_norm", key=where)
        current = ab_mag(sed, GRID, on_grid(GRID, wave, response))
        with np.errstate(over="ignore", invalid="ignore"):  # a spectrum of zeros becomes NaN, and is flagged
            return sed * 10 ** (0.4 * (current - target))


def _refuse_units(catalog: str, columns: Mapping[str, Sequence[Any]]) -> None:
    """Raise InputError for a quantity with a unit where csstsim needs a number."""
    for name, values in columns.items():
        value = next((value for value in values if hasattr(value, "unit")), None)
        if value is not None:
            raise InputError(
                "must be a plain number (units: catalog.base)", key=f"{catalog}._load, {name}", value=value
            )


def _timed(columns: Mapping[str, Sequence[Any]], count: int) -> dict[str, AnyArray]:
    """Return the columns of objects that change (catalog.changing.columns); an object without one has its default."""
    filled = {}
    for name, values in columns.items():
        default = changing.COLUMNS[name][1]
        filled[name] = np.array([default if value is None else value for value in values])
    return changing.completed(filled, count)


def _plain_column(values: Sequence[Any]) -> AnyArray | None:
    """Return a column of scalars, blanks (NaN or "") where an object has none; None if they are not plain values."""
    given = [value for value in values if value is not None]
    if not all(map(np.isscalar, given)):
        return None
    kind = np.array(given).dtype.kind
    if kind not in "biufU":
        return None
    blank = "" if kind == "U" else np.nan
    return np.array(given if len(given) == len(values) else [blank if value is None else value for value in values])


def name_of(catalog: CatalogBase) -> str:
    """Return the name of a catalogue's class, for messages."""
    return type(catalog).__name__


@contextmanager
def users_code(where: str) -> Iterator[None]:
    """Turn an exception of user code in the block into a one-line InputError: where, what, and the user's line."""
    with explained("catalogue"):
        try:
            yield
        except CsstsimError:
            raise
        except (Exception, SystemExit) as exc:  # a catalogue that calls sys.exit must not end a command silently
            frames = traceback.extract_tb(exc.__traceback__)[1:]
            frames = [f for f in frames if "site-packages" not in f.filename and not f.filename.startswith("<")]
            line = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
            raise InputError(f"{type(exc).__name__}: {exc}{line}", key=where) from exc
