"""Tables of csstsim as astropy Tables with units, and extracted spectra as specutils Spectrum objects."""

from __future__ import annotations

import json
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from csstsim.base.errors import InputError
from csstsim.base.shipped import SHIPPED
from csstsim.catalog.table import ObjectTable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from astropy.table import Table
    from astropy.units import UnitBase
    from specutils import Spectrum

    from csstsim.base.types import PathLike

_WORDS = {"px": "pix", "solar masses": "solMass"}  # that astropy calls otherwise
_FLUX_UNIT = "photon / s / m2 / angstrom"


@cache
def _schemas() -> list[dict[str, dict[str, Any]]]:
    """Return {column: field} of each table of config/schema/tables.json."""
    tables = json.loads((SHIPPED / "schema" / "tables.json").read_text())["tables"].values()
    return [{field["name"]: field for field in table["schema"]["fields"]} for table in tables]


def _fields(path: PathLike) -> dict[str, dict[str, Any]]:
    """Return {column: field} of the table of config/schema/tables.json whose columns are most like those of a file."""
    import pyarrow.parquet as pq

    names = set(pq.read_schema(path).names)
    return max(_schemas(), key=lambda fields: len(set(fields) & names) / len(set(fields) | names))


@cache
def _unit(text: str) -> UnitBase:
    """Return the astropy unit of csstsim's text, as of "photon / s / m2 / angstrom"."""
    from astropy.units import Unit

    for word, name in _WORDS.items():
        text = text.replace(word, name)
    above, *below = text.split(" / ")
    return Unit(above) / Unit(" ".join(below))


def read_table(path: PathLike, columns: Iterable[str] | None = None) -> Table:
    """Return a parquet table of csstsim as an astropy Table, with the units and descriptions of its columns.

    Parameters
    ----------
    path : str or Path
        A truth, order, measured, spectra, lines, merged or brick table.
    columns : iterable of str, optional
        Names of the columns that are read; the default is all.

    Returns
    -------
    Table
        Its `meta` is that of the file. Columns of your own (`user_...`) have no unit.

    Raises
    ------
    InputError
        For a file that is missing, damaged or not of csstsim.
    """
    from astropy.table import Table

    table = ObjectTable.read(path, columns)
    fields = _fields(path)
    result = Table({name: table[name] for name in table.names}, meta=dict(table.meta))
    for name in set(fields).intersection(result.colnames):
        if text := fields[name].get("unit"):
            result[name].unit = _unit(text)
        result[name].description = fields[name]["description"]
    return result


def read_spectra(path: PathLike) -> list[Spectrum]:
    """Return extracted spectra as specutils Spectrum objects; specutils must be installed.

    Parameters
    ----------
    path : str or Path
        A table of spectra, `spectra/{obsid}_{chip}.parquet`.

    Returns
    -------
    list of Spectrum
        In the table's order: flux and its standard deviation [photon / s / m2 / angstrom], over angstrom. `mask` is
        True where a column has no flux; `meta` has id, order, row (of the truth table) and the columns' `flags`.

    Raises
    ------
    InputError
        For a file that is missing, damaged or no table of spectra.
    ImportError
        If specutils is not installed.
    """
    from astropy.nddata import StdDevUncertainty
    from specutils import Spectrum

    table = ObjectTable.read(path)
    if not {"wavelength", "flux", "flux_err"} <= set(table.names):
        raise InputError("not a table of spectra", file=path, allowed="spectra/{obsid}_{chip}.parquet")
    keys = np.stack([table["id"], table["order"]])
    ends = np.flatnonzero((np.diff(keys) != 0).any(axis=0)) + 1
    spectra = []
    for rows in np.split(np.arange(len(table)), ends) if len(table) else ():
        part = table.take(rows)
        spectra.append(
            Spectrum(
                spectral_axis=part["wavelength"] * _unit("angstrom"),
                flux=part["flux"] * _unit(_FLUX_UNIT),
                uncertainty=StdDevUncertainty(part["flux_err"]),
                mask=~np.isfinite(part["flux"]),
                meta={name: int(part[name][0]) for name in ("id", "order", "row")} | {"flags": part["flags"]},
            )
        )
    return spectra
