"""CatalogBase: how any True Universe comes into the simulator (paper, section 3 and Appendix A).

A catalogue of your own is one class with the paper's four methods:

    class Mine(CatalogBase):
        def __init__(self, options, region):   # options: campaign.catalog.options; region: a Region
            super().__init__(options, region)
            self._load()
        def _load(self):                       # fill self.objs with MockObject(...)
            self.objs.append(MockObject(id=1, type="star", ra=10.0, dec=-2.0, mag_norm=18.0))
        def load_sed(self, obj):               # astropy Table: WAVELENGTH [A] and FLUX [photon / s / m2 / A]
            return Table({"WAVELENGTH": wave, "FLUX": flux})
        def load_norm_filt(self, obj):         # None: FLUX is absolute, as observed
            return None

A spectrum is in the observed frame: redshift, dust and Milky Way extinction are in it; lensing magnification
is not (csstsim applies it from kappa and gamma). If `load_norm_filt` returns a Table of WAVELENGTH and
SENSITIVITY (photon-counting response), the spectrum is rescaled to the object's `mag_norm` (AB) through it.

Speed: a catalogue with many objects overrides `load_seds`, or `load_fluxes` to skip spectra altogether.
"""

import hashlib
import importlib
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from csstsim.catalog.photometry import ab_mag, load_fluxes
from csstsim.catalog.table import ObjectTable
from csstsim.config import digest
from csstsim.errors import InputError
from csstsim.instrument.filter import GRID


@dataclass(frozen=True)
class Region:
    """The sky a catalogue is asked for: corners [deg, ICRS], margin added, and NSIDE-256 nested bricks they touch.

    The margin leaves a star 147 arcsec of motion since J2000; a catalogue with faster ones gives them besides.
    """

    ra: tuple[float, ...]
    dec: tuple[float, ...]
    bricks: tuple[int, ...]


class CatalogBase(ABC):
    """Objects of a region of the sky and their spectra."""

    def __init__(self, options, region):
        self.options = dict(options)
        self.region = region
        self.objs = []

    @abstractmethod
    def _load(self):
        """Fill `self.objs` with the MockObjects of `self.region` (more do no harm: selection is by position)."""

    @abstractmethod
    def load_sed(self, obj):
        """Return the spectrum of one MockObject: astropy Table, WAVELENGTH [A] rising within 2000-11000, FLUX."""

    @abstractmethod
    def load_norm_filt(self, obj):
        """Return None, or the Table (WAVELENGTH, SENSITIVITY) through which the spectrum has AB `obj.mag_norm`."""

    @property
    def table(self):
        """The objects as an ObjectTable, in the order of `self.objs`."""
        if getattr(self, "_table", None) is None:
            names = {name for obj in self.objs for name in obj.values}
            columns = {name: [getattr(obj, name, None) for obj in self.objs] for name in sorted(names)}
            # Extras may be anything (a file name, an array); only plain numbers travel as columns.
            plain = {name: values for name, values in columns.items() if all(np.isscalar(v) for v in values)}
            self._table = ObjectTable.complete(plain)
        return self._table

    @property
    def truth_hash(self):
        """16 hex digits of the options and the columns of `table` (spectra are not part of it)."""
        total = hashlib.sha256(digest(self.options).encode())
        for name in self.table:
            total.update(name.encode() + self.table[name].tobytes())
        return total.hexdigest()[:16]

    def load_seds(self, rows):
        """Return (len(rows), 18001) spectra [photon / s / m2 / A] on 2000-11000 A by 0.5 A for rows of `table`."""
        return np.array([self._load_on_grid(self.objs[row]) for row in rows]).reshape(len(rows), len(GRID))

    def load_fluxes(self, rows, filter, telescope):
        """Return (len(rows), 4) electrons / s in the filter's sub-bands, before lensing magnification."""
        return load_fluxes(self.load_seds, rows, filter, telescope)

    def _load_on_grid(self, obj):
        wave, flux = _columns(self, self.load_sed(obj), "FLUX", "load_sed", obj)
        sed = flux if np.array_equal(wave, GRID) else np.interp(GRID, wave, flux, left=0.0, right=0.0)
        norm = self.load_norm_filt(obj)
        if norm is None:
            return sed
        wave, response = _columns(self, norm, "SENSITIVITY", "load_norm_filt", obj)
        target = getattr(obj, "mag_norm", None)
        if target is None:
            raise InputError("load_norm_filt gave a filter but the object has no mag_norm", key=f"object {obj.id}")
        current = ab_mag(sed, GRID, np.interp(GRID, wave, response, left=0.0, right=0.0))
        return sed * 10 ** (0.4 * (current - target))


def _columns(catalog, table, name, method, obj):
    """Return WAVELENGTH and `name` of what a user's method gave; InputError if it is not of that form."""
    where = f"{type(catalog).__name__}.{method}, object {obj.id}"
    try:
        wave, values = (np.asarray(table[column], dtype=float) for column in ("WAVELENGTH", name))
    except (KeyError, TypeError, ValueError, IndexError):
        raise InputError(f"must return a table with the columns WAVELENGTH and {name}", key=where) from None
    if wave.ndim != 1 or len(wave) < 2 or wave.shape != values.shape or not (np.diff(wave) > 0).all():
        raise InputError("WAVELENGTH must rise and match its column in length", key=where)
    return wave, values


def catalog_class(kind):
    """Return the CatalogBase class named 'module.path:ClassName'. Raises InputError if there is none."""
    module_name, colon, class_name = kind.partition(":")
    if not (colon and module_name and class_name):
        raise InputError("unknown catalogue", key="catalog.kind", value=kind, allowed="embedded, module.path:ClassName")
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as exc:
        if exc.name is not None and (module_name == exc.name or module_name.startswith(f"{exc.name}.")):
            raise InputError(f"no module {exc.name!r} on the Python path", key="catalog.kind", value=kind) from None
        raise
    found = getattr(module, class_name, None)
    if not (isinstance(found, type) and issubclass(found, CatalogBase)):
        allowed = ", ".join(
            name for name, member in vars(module).items()
            if isinstance(member, type) and issubclass(member, CatalogBase) and member is not CatalogBase
        )  # fmt: skip
        raise InputError(
            "not a CatalogBase class of that module", key="catalog.kind", value=kind, allowed=allowed or None
        )
    return found
